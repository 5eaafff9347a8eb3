from pathlib import Path

from PIL import Image

from stylesplat.demo.report import Figure, Section, write_report


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
    assert "http" not in page and str(tmp_path) not in page
    assert page.count("var(--at, 57%)") == 2 and 'value="57"' in page
    assert "$" not in page, "every placeholder is filled"
