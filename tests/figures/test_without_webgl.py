from balls import CAMERAS, SPLATS
from chromium import launched, needs_chromium
from stylesplat.figures.browser import serve_viewer

SAID = "(document.body && document.body.innerText) || ''"


@needs_chromium
def test_a_browser_without_webgl_is_told_what_helps():
    """By viser's own page."""
    server = serve_viewer(SPLATS, cameras=CAMERAS, port=0, block=False)
    try:
        with launched(600, 400, "--disable-3d-apis") as page:
            page.open(server.url)
            page.until(f"({SAID}).includes('WebGL is unavailable')")
            assert "hardware acceleration" in page.evaluate(SAID)
    finally:
        server.stop()
