"""What tests of several packages share: the embedded example, notebooks, a browser."""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jupytext
import panel as pn
import pytest
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


WATCH = """
() => {
  const deep = (root, found) => {
    root.querySelectorAll('*').forEach(e => { if (e.shadowRoot) deep(e.shadowRoot, found); });
    root.querySelectorAll('canvas').forEach(c => { if (c.width > 100) found.push(c); });
    return found;
  };
  const canvases = deep(document, []);
  const hash = c => {
    const pixels = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
    let h = 0;
    for (let i = 0; i < pixels.length; i += 97) h = (h * 31 + pixels[i]) | 0;
    return h;
  };
  // Milliseconds from the key to the first frame that shows another picture.
  window.arm = index => {
    window.shown = null;
    const before = hash(canvases[index]);
    let start = null;
    document.addEventListener('keydown', () => { start = performance.now(); }, {capture: true, once: true});
    const look = () => {
      if (start !== null && hash(canvases[index]) !== before) window.shown = performance.now() - start;
      else requestAnimationFrame(look);
    };
    look();
  };
}
"""
Move = tuple[int, int, tuple[str, ...]]
"""Slider (in the order of the panel), canvas (two a picture) that it changes, and keys in turn."""


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


@pytest.fixture
def screen_times(browser: Any) -> Callable[..., dict[str, float]]:
    """Seconds from a key on a slider to another picture on the screen, in a panel served on this machine."""

    def measure(
        make: Callable[[], Any], moves: Mapping[str, Move], size: tuple[int, int]
    ) -> dict[str, float]:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        server = pn.serve(make, port=port, show=False, threaded=True, address="127.0.0.1")
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(60_000)
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector("canvas")
        page.wait_for_timeout(3000)
        page.evaluate(WATCH)
        handles = page.locator(".noUi-handle")
        times: dict[str, list[float]] = {name: [] for name in moves}
        for turn in range(4):
            for name, (slider, canvas, keys) in moves.items():
                handles.nth(slider).focus()
                page.evaluate(f"window.arm({canvas})")
                page.keyboard.press(keys[turn % len(keys)])
                page.wait_for_function("window.shown !== null", polling=50)
                times[name].append(page.evaluate("window.shown") / 1000)
                page.wait_for_timeout(200)
        page.close()
        server.stop()
        print({name: [round(t, 3) for t in values] for name, values in times.items()})
        # The first move compiles and warms up; of the others the best is least disturbed by the machine.
        return {name: min(values[1:]) for name, values in times.items()}

    return measure
