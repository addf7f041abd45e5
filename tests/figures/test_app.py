"""The panels of a site as pages."""

import socket

import panel as pn
import pytest

from workbench.errors import SiteError
from workbench.figures.app import site_pages
from workbench.params import Parameters
from workbench.site import Site, load_site


@pytest.mark.slow
def test_every_page_of_the_embedded_example_is_served_and_drawn(lake_root, browser):
    pages = site_pages(load_site("lake", lake_root), Parameters(), root=lake_root)
    assert set(pages) >= {"surface", "pairs", "reed", "trees"}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = pn.serve(dict(pages), port=port, show=False, threaded=True, address="127.0.0.1")
    for page in pages:
        seen = browser.new_page()
        seen.goto(f"http://127.0.0.1:{port}/{page}")
        seen.wait_for_selector(".noUi-handle", timeout=60_000)
        seen.wait_for_selector("canvas, img", timeout=60_000)
        seen.close()
    server.stop()


def test_a_site_without_products_says_what_to_run(tmp_path):
    site = Site("meadow", tmp_path, None, None, (), {})
    with pytest.raises(SiteError, match="workbench run --site meadow"):
        site_pages(site, Parameters())
