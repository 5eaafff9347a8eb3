"""A page that holds a splat: what is in it, and what a real browser shows of it."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from balls import CAMERAS, SPLATS, enlarged
from browser import Browser, Page, as_url, element, needs_chromium, read, scene
from stylesplat.errors import StyleSplatError
from stylesplat.figures.web_page import page_of
from stylesplat.io.splats.packing import morton_order
from stylesplat.rendering.reference import rotation_matrices
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras, up_vector
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.verbs.export import export

SCENE = scene()
SIZE = (480, 360)
VIEWS = enlarged(CAMERAS, 10)


def test_a_page_holds_the_numbers_within_their_rounding():
    found = read(page_of(SCENE, title="balls"))
    rows = morton_order(SCENE.splats.means)
    new = SCENE.splats[len(SCENE.base) :]
    hidden = replace(new, opacities=torch.full_like(new.opacities, -16.0))
    splats, before = SCENE.splats[rows], Splats.cat([SCENE.base, hidden])[rows]
    assert found.about["count"] == len(splats)
    painted = (splats.sh0 != before.sh0).flatten(1).any(dim=1)
    painted |= splats.opacities != before.opacities
    assert found.about["painted"] == int(painted.sum())
    low, high = (torch.tensor(each) for each in zip(*found.about["means"], strict=True))
    step = (high - low).max() / 65535 * found.about["reach"]
    outward = 1 + (splats.means - torch.tensor(found.about["middle"])).abs() / found.about["reach"]
    assert ((found.splats.means - splats.means).abs() <= 0.51 * step * outward + 1e-6).all()
    low, high = found.about["scales"]
    assert (found.splats.scales - splats.scales).abs().max() <= 0.51 * (high - low) / 255
    turned = rotation_matrices(found.splats.quats) - rotation_matrices(splats.quats)
    assert turned.abs().max() < 0.02  # three parts, each within 0.003
    opacities = torch.sigmoid(found.splats.opacities) - torch.sigmoid(splats.opacities)
    assert opacities.abs().max() <= 0.51 / 255
    low, high = found.about["colors"]
    for one, other in ((found.splats, splats), (found.before, before)):
        mean = rgb_from_sh0(one.sh0) - rgb_from_sh0(other.sh0)
        assert mean.abs().max() <= 0.51 * (high - low) / 255
        rest = (one.shN - other.shN).square().mean() / other.shN.square().mean()
        assert rest < 0.15, "300 kinds"
    assert found.splats.shN[(splats.shN == 0).all(dim=2).all(dim=1)].eq(0).all()


def test_what_does_not_show_is_left_out():
    faint = SPLATS.opacities.clone()
    faint[:100] = -6.0
    assert read(page_of(replace(SPLATS, opacities=faint), title="")).about["count"] == 340
    found = read(page_of(SCENE, title="", sh_degree=0))
    assert (found.about["bands"], found.splats.shN.shape[1]) == (0, 0)
    assert read(page_of(SCENE, title="", sh_degree=1)).about["bands"] == 3


def test_where_it_starts_and_what_it_names():
    about = read(page_of(SCENE, title="")).about
    assert np.allclose(about["start"]["position"], CAMERAS.positions[0])
    assert np.allclose(about["start"]["up"], up_vector(CAMERAS))
    assert np.allclose(about["start"]["slopes"], [48 / 50, 36 / 50])
    assert {each["name"]: each["painted"] for each in about["objects"]} == {
        "red": True,
        "green": False,
        "blue": True,
    }
    (red,) = (each for each in about["objects"] if each["name"] == "red")
    assert np.allclose(red["centre"], [-0.7, 0.0, 0.3], atol=0.05)
    alone = read(page_of(SPLATS, title="")).about
    assert alone["start"]["up"] == [0, 0, 1] and alone["objects"] == [] and alone["painted"] == 0


def test_a_page_needs_nothing_else_and_names_cannot_break_out():
    named = replace(SCENE, objects={"<!--<script>": SCENE.objects["red"]})
    page = page_of(named, title="<b>&")
    assert "<title>&lt;b&gt;&amp;</title>" in page
    assert "default-src 'none'" in page
    assert json.loads(element(page, "about"))["objects"][-1]["name"] == "<!--<script>"
    assert "<!--" not in page.removeprefix("<!doctype html>")
    shell = page.replace(element(page, "splats"), "")
    assert not [word for word in ("://", "src=", "href=", "@import", "url(") if word in shell]


def test_refusals(tmp_path: Path):
    page = tmp_path / "a.html"
    export(SCENE, page)
    with pytest.raises(StyleSplatError, match=r"a\.html exists.*--overwrite"):
        export(SCENE, page)
    export(SPLATS, page, overwrite=True)
    assert read(page.read_text()).about["count"] == len(SPLATS)
    for nothing in (SPLATS[torch.arange(0)], replace(SPLATS, opacities=SPLATS.opacities - 99)):
        with pytest.raises(StyleSplatError, match="No Gaussian shows"):
            export(nothing, tmp_path / "b.html")
    assert [*tmp_path.iterdir()] == [page]


@pytest.fixture(scope="module")
def browser(chromium: Browser) -> Iterator[Page]:
    with chromium.tab(*SIZE) as page:
        yield page


@pytest.fixture
def shown(browser: Page, tmp_path: Path) -> Page:
    """The page of the painted balls, open from the disk."""
    file = tmp_path / "balls.html"
    export(SCENE, file)
    browser.call("Network.enable")
    browser.open(as_url(file))
    assert message(browser) == ""
    return browser


def message(page: Page) -> str:
    """What the page says once the splat is unpacked: nothing, or why it cannot show it."""
    said = "document.getElementById('message').innerText"
    page.until(f"!{said}.startsWith('Unpacking')")
    return page.evaluate(said)


def picture(page: Page, view: Cameras, cut: float) -> torch.Tensor:
    """What it shows from a camera of ours."""
    K = view.Ks[0]
    camera = {
        "viewmat": view.viewmats[0].flatten().tolist(),
        "focal": [float(K[0, 0]), float(K[1, 1])],
        "centre": [float(K[0, 2]), float(K[1, 2])],
    }
    page.evaluate("document.body.classList.remove('compared')")
    page.evaluate("document.querySelector('footer').style.display = 'none'")
    page.evaluate(f"viewer.draw({json.dumps(camera)}, {cut})")
    return torch.from_numpy(page.screenshot() / 255).float()


def drawn(splats: Splats, view: Cameras) -> torch.Tensor:
    image, alphas, _ = rasterize(splats, view, backend="cpu")
    return (image[0] + (1 - alphas[0]) * torch.tensor([22, 22, 24]) / 255).clamp(0, 1)


def far(view: Cameras) -> Cameras:
    """With so short a lens that Gaussians are smaller than pixels."""
    Ks = view.Ks.clone()
    Ks[:, [0, 1], [0, 1]] /= 10
    return replace(view, Ks=Ks)


def psnr(one: torch.Tensor, other: torch.Tensor) -> float:
    return float(-10 * (one - other).square().mean().log10())


@needs_chromium
def test_a_browser_shows_what_our_rasteriser_does(shown: Page):
    held = read(page_of(SCENE, title=""))
    for view in (VIEWS[0], VIEWS[3], far(VIEWS[0])):
        after, before = (drawn(each, view) for each in (held.splats, held.before))
        split = torch.cat([before[:, : SIZE[0] // 2], after[:, SIZE[0] // 2 :]], dim=1)
        shown_is = [psnr(picture(shown, view, cut), is_) for cut, is_ in ((0, after), (1, before))]
        # Both blend the same numbers, but a browser in steps of 1/255
        assert min(*shown_is, psnr(picture(shown, view, 0.5), split)) > 48
        assert max(psnr(after, before), psnr(after, split), psnr(before, split)) < 47, "they differ"
    asked = [e["params"] for e in shown.events if e["method"] == "Network.requestWillBeSent"]
    assert [each["type"] for each in asked] == ["Document"], "nothing else is loaded"
    assert shown.complaints() == []


def test_pages_say_whether_splats_are_antialiased():
    for antialiased in (False, True):
        page = page_of(replace(SPLATS, antialiased=antialiased), title="")
        assert read(page).splats.antialiased == antialiased


@needs_chromium
def test_a_browser_fades_antialiased_splats_as_our_rasteriser_does(browser: Page, tmp_path: Path):
    file, view = tmp_path / "far.html", far(VIEWS[0])
    splats = replace(SPLATS, antialiased=True)
    export(splats, file)
    held = read(page_of(splats, title="")).splats
    browser.open(as_url(file))
    assert message(browser) == ""
    found = picture(browser, view, 0)
    assert psnr(found, drawn(held, view)) > 60
    assert psnr(found, drawn(replace(held, antialiased=False), view)) < 60, "they differ"


@needs_chromium
def test_hands(shown: Page):
    def looks() -> list[float]:
        return shown.evaluate("[...viewer.camera.target, viewer.camera.distance]")

    def turned() -> float:
        return shown.evaluate("viewer.camera.turned")

    def drag(start: tuple[int, int], end: tuple[int, int]) -> None:
        shown.mouse("press", *start)
        shown.mouse("move", *end, button="left", buttons=1)
        shown.mouse("release", *end)

    first, angle = looks(), turned()
    assert shown.evaluate("document.getElementById('cut').style.left") == "50%"
    drag((240, 180), (360, 170))
    assert shown.evaluate("document.getElementById('knob').getAttribute('aria-valuenow')") == "75"
    assert (looks(), turned()) == (first, angle), "the handle is not the scene"
    shown.evaluate("document.getElementById('knob').focus()")
    shown.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowRight")
    assert shown.evaluate("document.getElementById('cut').style.left") == "77%"
    drag((100, 200), (150, 200))
    assert turned() == pytest.approx(angle - np.pi * 50 / SIZE[1])
    shown.call("Input.dispatchMouseEvent", type="mouseWheel", x=100, y=200, deltaX=0, deltaY=100)
    assert looks()[3] > first[3]
    shown.evaluate("[...document.querySelectorAll('#legend button')].at(-1).click()")
    assert shown.evaluate("document.querySelectorAll('#legend .painted').length") == 2
    centre = read(page_of(SCENE, title="")).about["objects"][-1]["centre"]
    assert np.allclose(looks()[:3], centre)
    shown.evaluate("document.getElementById('canvas').focus()")
    shown.call("Input.dispatchKeyEvent", type="keyDown", key="r", code="KeyR")
    assert np.allclose([*looks(), turned()], [*first, angle])
    assert shown.complaints() == []


@needs_chromium
def test_browsers_that_cannot_say_so(browser: Page, tmp_path: Path):
    export(SPLATS, tmp_path / "a.html")
    for missing, said in (
        ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2 is missing"),
        ("delete window.DecompressionStream", "too old"),
    ):
        script = browser.call("Page.addScriptToEvaluateOnNewDocument", source=missing)
        browser.open(as_url(tmp_path / "a.html"))
        assert said in message(browser)
        browser.call("Page.removeScriptToEvaluateOnNewDocument", **script)
