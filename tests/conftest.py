"""What tests of several packages share: the embedded example, notebooks, a browser."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jupytext
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


@pytest.fixture(scope="session")
def execute_notebook() -> Callable[..., Any]:
    """Run a notebook of the repository on a root folder; its outputs are in the notebook returned."""

    def execute(name: str, root: Path, timeout: int = 900, **environment: str) -> Any:
        notebook = jupytext.read(NOTEBOOKS / f"{name}.ipynb")
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("WORKBENCH_ROOT", str(root))
            for key, value in environment.items():
                patch.setenv(key, value)
            NotebookClient(notebook, timeout=timeout, kernel_name="python3").execute()
        return notebook

    return execute


@pytest.fixture(scope="session")
def lake_root(tmp_path_factory: pytest.TempPathFactory, execute_notebook: Callable[..., Any]) -> Path:
    """Root with all products of the embedded example, made once by notebook 01. Do not write into it."""
    root = tmp_path_factory.mktemp("lake")
    execute_notebook("01_first_look", root)
    return root


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium; tests that need it skip where there is none."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium on this machine: install it to test reports and dashboards in a browser")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=chromium,
            args=["--no-sandbox", "--disable-gpu", "--disable-background-networking"],
        )
        yield started
        started.close()
