"""Textured meshes of a ball of Gaussians."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from meshes import draw
from scenes import UP, cloud, plain_layer, shell
from stylesplat.errors import StyleSplatError
from stylesplat.meshes.mesh import make_mesh
from stylesplat.meshes.mesh_config import MeshConfig
from stylesplat.meshes.mesh_files import write_mesh
from stylesplat.meshes.rasterize import NOTHING, draw_mesh
from stylesplat.meshes.refine import refine
from stylesplat.meshes.repaint import repaint
from stylesplat.meshes.surface import (
    FusedSurface,
    MeshViews,
    find_mesh_surface,
    mesh_views,
    split_nonmanifold_edges,
)
from stylesplat.meshes.texture import TexturedMesh
from stylesplat.meshes.unwrap import unwrap_faces
from stylesplat.rendering.render import render
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.scene.virtual_cameras import ring_cameras
from stylesplat.verbs.export import export

RADIUS = 0.5
SIZE = 0.02  # of its Gaussians
SMALL = MeshConfig(faces=2000, texture_size=256)


def ball(opacity: float = 4.0) -> Splats:
    """Its colours are smooth in space."""
    points = shell(4000, RADIUS)
    colors = 0.5 + 0.4 * torch.sin(6 * points)
    return replace(cloud(points, SIZE, opacity), sh0=sh0_from_rgb(colors)[:, None])


BALL = ball()
RING = ring_cameras(BALL, UP)
CAMERAS = RING[::3]
MOST = RING[[row for row in range(len(RING)) if row % 3 < 2]]
LAYER = replace(
    plain_layer(BALL, torch.arange(len(BALL)), "ball", settings={}, form=0.0),
    sh0=BALL.sh0,
    opacity_factors=torch.ones(len(BALL)),
)


@pytest.fixture(scope="module")
def views() -> MeshViews:
    return mesh_views(BALL, CAMERAS, length=200)


@pytest.fixture(scope="module")
def mesh() -> TexturedMesh:
    return make_mesh(BALL, None, SMALL)


def merged(mesh: TexturedMesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces)  # merges vertices of one place


def test_the_surface_is_closed_and_in_its_place(mesh: TexturedMesh):
    found = merged(mesh)
    assert found.is_watertight and found.is_winding_consistent and found.volume > 0
    assert 1000 < len(mesh.faces) <= 2000
    radii = np.linalg.norm(mesh.vertices, axis=1)
    # Rays along the ball pass many Gaussians: its outline lies two of their sizes outside.
    assert abs(radii - RADIUS - SIZE).max() < 0.1 * RADIUS
    assert (np.abs(np.linalg.norm(mesh.normals, axis=1) - 1) < 1e-4).all()
    assert ((mesh.normals * mesh.vertices).sum(axis=1) > 0.9 * radii).all()


def test_renders_are_those_of_the_splats(mesh: TexturedMesh):
    for row in (0, 7):
        camera = CAMERAS[row].downscale(4)
        image, shown = draw(mesh, camera)
        wanted, covered = render(BALL, camera)
        solid = (covered[..., 0] > 0.5).numpy()
        assert (shown & solid).sum() > 0.9 * (shown | solid).sum()
        both = shown & (covered[..., 0] > 0.9).numpy()
        error = np.square(image - wanted.numpy() / covered.numpy().clip(0.1))[both].mean()
        assert -10 * np.log10(error) > 28


def test_faces_that_touch_at_an_edge_are_moved_apart():
    points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]]
    faces = [(0, 3, 2), (0, 2, 1), (2, 3, 1), (3, 0, 1)]  # a tetrahedron at the edge 0, 1
    faces += [(0, 5, 4), (0, 4, 1), (4, 5, 1), (5, 0, 1)]
    vertices = np.array(points, np.float32)
    surface = FusedSurface(vertices, np.array(faces, np.int32), np.zeros(len(points), np.float32))
    assert not trimesh.Trimesh(surface.vertices, surface.faces).is_watertight
    surface = split_nonmanifold_edges(surface)
    found = trimesh.Trimesh(surface.vertices, surface.faces)
    assert found.is_watertight and found.is_winding_consistent
    assert abs(found.volume - 1 / 3) < 0.02


def test_nearer_faces_hide_others():
    vertices = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], np.float32)
    ahead = np.array([0, 0, 1], np.float32)
    both = np.concatenate([vertices + 2 * ahead, vertices + ahead])
    faces = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    K = torch.tensor([[[8.0, 0, 4], [0, 8, 4], [0, 0, 1]]])
    camera = Cameras(torch.eye(4)[None], K, torch.tensor([[8, 8]]), ("a",))
    fragments = draw_mesh(both, faces, camera)
    assert (fragments.faces == 1).all() and np.allclose(fragments.depths, 1)
    assert np.allclose(fragments.weights.sum(axis=2), 1, atol=1e-5)


def test_vertices_move_to_where_views_agree(mesh: TexturedMesh, views: MeshViews):
    surface = merged(mesh)
    directions = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    true = np.linalg.norm(surface.vertices, axis=1)
    dents = 0.04 * RADIUS * np.sin(4 * directions[:, :1])
    dented = FusedSurface(
        (surface.vertices + dents * directions).astype(np.float32),
        surface.faces.astype(np.int32),
        np.zeros(len(true), np.float32),
    )
    moved = refine(dented, BALL, views).vertices
    before, after = (np.linalg.norm(each, axis=1) - true for each in (dented.vertices, moved))
    assert np.square(after).mean() < 0.5 * np.square(before).mean()


def test_vertices_move_to_outlines(mesh: TexturedMesh, views: MeshViews):
    grey = replace(BALL, sh0=torch.zeros_like(BALL.sh0))  # so that colours agree everywhere
    found = merged(mesh)
    surface = FusedSurface(
        (0.93 * found.vertices).astype(np.float32),
        found.faces.astype(np.int32),
        np.zeros(len(found.vertices), np.float32),
    )

    def difference(vertices: np.ndarray) -> float:
        """Pixels of the first views that either shows alone."""
        total = 0
        for row in range(8):
            camera = views.cameras[row]
            solid = (render(BALL, camera)[1][..., 0] > 0.5).numpy()
            shown = draw_mesh(vertices, surface.faces, camera).faces != NOTHING
            total += (shown ^ solid).sum() / solid.sum()
        return total

    moved = refine(surface, grey, views)
    assert difference(moved.vertices) < 0.3 * difference(surface.vertices)


def test_a_hole_where_it_stands_is_closed(said: list[str]):
    standing = BALL[BALL.means[:, 2] > -0.9 * RADIUS]
    found = merged(make_mesh(standing, MOST, SMALL))
    assert found.is_watertight and not said
    assert found.bounds[0, 2] < -0.85 * RADIUS


def test_what_nobody_photographed_is_open(said: list[str]):
    front = CAMERAS[[row for row in range(len(CAMERAS)) if CAMERAS[row].positions[0, 0] > 1]]
    found = merged(make_mesh(BALL, front, SMALL, name="vase"))
    assert not found.is_watertight
    assert any("vase was photographed from one side only" in line for line in said)


def test_a_flat_object_is_open_behind_whatever_the_faces():
    """Its back lies few voxels behind its front."""
    flat = replace(BALL, means=BALL.means * torch.tensor([0.2, 1.0, 1.0]))
    front = CAMERAS[[row for row in range(len(CAMERAS)) if CAMERAS[row].positions[0, 0] > 1.5]]
    few, many = (find_mesh_surface(flat, front, faces, "a coin")[1] for faces in (500, 20_000))
    assert few > 0.4 and many > 0.4


def test_smoke_has_no_surface():
    with pytest.raises(StyleSplatError, match=r"smoke has no surface.*see through"):
        make_mesh(ball(opacity=-4.5), RING[::6], SMALL, name="smoke")


@pytest.mark.parametrize(
    ("settings", "fact"),
    [
        ({"faces": 99}, "faces 99"),
        ({"texture_size": 1000}, "1000 pixels"),
        ({"texture_size": 16384}, "to 8,192"),
        ({"texture_size": 0}, "texture_size 0"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], fact: str):
    with pytest.raises(StyleSplatError, match=fact):
        MeshConfig(**settings)


def test_packages_that_are_missing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(StyleSplatError, match=r"xatlas.*stylesplat\[mesh\]"):
        make_mesh(BALL, None, SMALL)


def test_other_programs_read_the_files(mesh: TexturedMesh, tmp_path: Path):
    cameras = CAMERAS[::2].downscale(4)
    picked = torch.ones(len(BALL), dtype=torch.bool)
    scene = Scene(BALL, cameras, objects={"ball": SceneObject(picked)})
    write_mesh(mesh, tmp_path / "a.obj")
    count = export(scene, tmp_path / "a.glb", objects=["ball"], mesh=SMALL)
    for name in ("a.glb", "a.obj"):
        found: Any = trimesh.load_mesh(tmp_path / name)
        assert len(found.faces) == (count if name == "a.glb" else len(mesh.faces))
        assert found.visual.uv.shape == (len(found.vertices), 2)
        colors = found.visual.to_color().vertex_colors[:, :3] / 255
        in_scene = found.vertices * [-1, -1, 1]
        assert np.abs(colors - 0.5 - 0.4 * np.sin(6 * in_scene)).mean() < 0.06
    with pytest.raises(StyleSplatError, match=r"a\.mtl exists"):
        (tmp_path / "a.obj").unlink()
        export(scene, tmp_path / "a.obj", mesh=SMALL)
    with pytest.raises(StyleSplatError, match=r"\.glb or \.obj"):
        export(scene, tmp_path / "a.ply", mesh=SMALL)
    with pytest.raises(StyleSplatError, match="means nothing for a mesh"):
        export(scene, tmp_path / "b.glb", mesh=SMALL, sidecar=True)


def test_what_cannot_be_repainted(tmp_path: Path):
    picked = torch.ones(len(BALL), dtype=torch.bool)
    scene = Scene(BALL, CAMERAS, objects={"ball": SceneObject(picked)})
    config = replace(SMALL, repaint=True)
    with pytest.raises(StyleSplatError, match="ball is not painted"):
        export(scene, tmp_path / "a.glb", objects=["ball"], mesh=config)
    painted = scene.with_layers([LAYER])
    with pytest.raises(StyleSplatError, match="a picture of its style is gone"):
        export(painted, tmp_path / "a.glb", objects=["ball"], mesh=config)


def test_repainting_brings_the_style(
    mesh: TexturedMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("stylesplat.meshes.repaint.REPAINT_STEPS", 40)
    stripes = np.zeros((96, 96, 3), np.uint8)
    stripes[:, ::6], stripes[:, 1::6], stripes[:, 2::6] = 250, 250, 250
    Image.fromarray(stripes).save(tmp_path / "stripes.png")
    (source,) = LAYER.styles
    source = replace(source, path=tmp_path / "stripes.png", sha256=None)
    views = mesh_views(BALL, CAMERAS[[0, 2, 4, 6]].downscale(4), length=160)
    found = repaint(mesh, BALL, views, replace(LAYER, styles=(source,)), "ball").texture
    before, after = (np.abs(np.diff(each, axis=1)).mean() for each in (mesh.texture, found))
    assert after > 1.2 * before, "strokes are sharper than what was there"


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_files_have_the_coordinates_of_the_world(suffix: str, mesh: TexturedMesh, tmp_path: Path):
    """At four million metres float32 has steps of a quarter; both formats have more digits."""
    near, far = tmp_path / f"near{suffix}", tmp_path / f"far{suffix}"
    write_mesh(mesh, near)
    write_mesh(mesh, far, (4e6, -3e6, 5e6))
    places = [trimesh.load_scene(path).to_mesh().vertices for path in (near, far)]
    moved = places[0] + [-4e6, 3e6, 5e6]  # turned by half, as all of it
    np.testing.assert_allclose(places[1], moved, atol=1e-5)


def test_faces_that_cannot_be_unwrapped():
    corners = np.eye(3, dtype=np.float32)
    with pytest.raises(StyleSplatError, match=r"1 face.*--faces"):
        unwrap_faces(corners, np.array([[0, 1, 7]]), 64)
