from pathlib import Path

from PIL import Image

from balls import CAMERAS, SPLATS
from chromium import as_url, launched, needs_chromium
from stylesplat.demo.report import write_report
from stylesplat.figures.html_page import Figure, Section
from stylesplat.scene.scene import Scene
from stylesplat.verbs.export import export


def test_report_holds_everything_and_names_no_file(tmp_path: Path):
    picture, video = tmp_path / "a.png", tmp_path / "b.mp4"
    Image.new("RGB", (4, 3), (9, 8, 7)).save(picture)
    video.write_bytes(b"frames")
    section = Section("Heads & tails", "1 < 2", (Figure(picture, "left"), Figure(video, "right")))
    write_report(
        tmp_path / "report.html",
        before=picture,
        after=picture,
        cut=0.57,
        sections=(section,),
        numbers={"PSNR": "30 dB"},
    )
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert page.count("data:video/mp4;base64,ZnJhbWVz") == 1
    assert "Heads &amp; tails" in page and "1 &lt; 2" in page
    assert "<th>PSNR</th><td>30 dB</td>" in page
    assert "://" not in page and str(tmp_path) not in page
    assert page.count("var(--at, 57%)") == 2 and 'value="57"' in page
    assert "$" not in page, "every placeholder is filled"


@needs_chromium
def test_report_shows_the_splat_itself(tmp_path: Path):
    picture, page = tmp_path / "a.png", tmp_path / "splat.html"
    Image.new("RGB", (80, 5), (9, 8, 7)).save(picture)
    export(Scene(SPLATS, CAMERAS), page)
    write_report(
        tmp_path / "report.html",
        before=picture,
        after=picture,
        cut=0.5,
        sections=(Section("The splat", "", (Figure(page, "splat.html"),)),),
        numbers={},
    )
    page.unlink()
    with launched(500, 700) as browser:
        browser.open(as_url(tmp_path / "report.html"))
        browser.evaluate("document.querySelector('iframe').scrollIntoView()")
        browser.until("document.querySelector('iframe').contentWindow.viewer")
        box = browser.evaluate("document.querySelector('iframe').getBoundingClientRect().toJSON()")
        left, top, right, bottom = (round(box[side]) for side in ("left", "top", "right", "bottom"))
        shown = browser.screenshot()[top:bottom, left:right].astype(int)
        assert (shown[..., 0] > shown[..., 1] + 100).mean() > 0.02, "the red ball"
        assert (shown[..., 1] > shown[..., 0] + 100).mean() > 0.02, "the green ball"
        assert browser.complaints() == []
