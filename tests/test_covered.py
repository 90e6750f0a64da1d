"""What silhouettes draw: of closed surfaces the half that is not turned away, which covers what all faces cover, pixel for pixel."""

import numpy as np
import pytest
from corpus import FAR, icosahedron, project, rotation

from dressi_edge.cache.layout import Layout
from dressi_edge.compiler import Program
from dressi_edge.compiler.graph.functions import constant_table
from dressi_edge.compiler.graph.optable import apply
from dressi_edge.compiler.io.shapes import icosphere
from dressi_edge.compiler.render.atlas import Atlas
from dressi_edge.compiler.render.raster import Softness, rasterized
from dressi_edge.compiler.render.topology import Topology

pytest_plugins = ["gpu"]

SIZE, VIEWS, COLUMNS, NEAR = (37, 29), 12, 4, 0.1
BALL, FACES = icosahedron()
TETRAHEDRON = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])

# Which surfaces are closed


@pytest.mark.parametrize("faces, closed", {
    "closed": (TETRAHEDRON, [1, 1, 1, 1]),
    "inside out": (TETRAHEDRON[:, ::-1], [1, 1, 1, 1]),
    "open": (TETRAHEDRON[1:], [0, 0, 0]),
    "one face turned": (np.array([(0, 2, 1), *TETRAHEDRON[1:]]), [0, 0, 0, 0]),
    "two apart": (np.concatenate([TETRAHEDRON + 4, TETRAHEDRON[:3]]), [1, 1, 1, 1, 0, 0, 0]),
    "two that share a vertex": (np.concatenate([TETRAHEDRON, TETRAHEDRON[:3] + 3]), [0] * 7),
    "both sides of a face": (np.array([(0, 1, 2), (0, 2, 1)]), [1, 1]),
    "the same twice": (np.concatenate([TETRAHEDRON, TETRAHEDRON]), [1] * 8),
    "a face without area": (np.array([*TETRAHEDRON, (0, 0, 1)]), [1, 1, 1, 1]),
    "three faces at an edge": (np.array([*TETRAHEDRON, (0, 1, 4)]), [0] * 5),
}.values(), ids=lambda x: "" if isinstance(x, list) else None)
def test_a_surface_is_closed_where_each_edge_is_passed_as_often_either_way(faces, closed):
    assert Topology(faces, 8).closed.tolist() == [bool(c) for c in closed]


def test_a_long_surface_hangs_together():
    """As many rounds as a naive search would need are not made, and the numbers along it are in no order."""
    count = 4000
    k, order = np.arange(count), np.random.default_rng(0).permutation(2 * count)
    a, b, c, d = 2 * k, 2 * k + 1, 2 * ((k + 1) % count), 2 * ((k + 1) % count) + 1
    belt = order[np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])]
    sides = belt[:, ::-1]
    assert Topology(np.concatenate([belt, sides]), 2 * count).closed.all()
    assert not Topology(np.concatenate([belt, sides[1:]]), 2 * count).closed.any()


# That all is covered


def program_of(topology):
    """Both ways to draw what is in front, which must be the same to the pixel."""
    p, atlas = Program(), Atlas(*SIZE, VIEWS, COLUMNS)
    clip = p.input("clip", Layout("table", "vec4", count=topology.vertex_count * VIEWS))
    image = Layout("atlas", "int", *SIZE, VIEWS, COLUMNS)
    p.plan("draw", {}, {name: (rasterized(clip, topology, atlas, Softness(), NEAR, faces).front >= 0, image)
                        for name, faces in (("all", True), ("half", False))})
    return p


def smooth(rng, x):
    return 0.8 * x @ rotation(rng.integers(1 << 30)) + rng.uniform(-0.5, 0.5, 3) + (0, 0, -3)


def inside_out(rng, x):
    return smooth(rng, x * (-1, 1, 1))


def crumpled(rng, x):
    return smooth(rng, x + rng.normal(scale=0.6, size=x.shape))


def soup(rng, x):
    return rng.normal(size=x.shape) + (0, 0, -6)


def flat(rng, x):
    """Seen from the edge, nearly."""
    return smooth(rng, x) * (1, 10.0 ** rng.uniform(-6, -1), 1)


def small(rng, x):
    return smooth(rng, x * 10.0 ** rng.uniform(-4, -1))


def lattice(rng, x):
    """Corners on pixel centres and on each other: w is 1."""
    return np.append(2 * rng.integers(-8, 9, (len(x), 2)) / np.array(SIZE), np.tile([0.5, 1.0], (len(x), 1)), 1)


def off_screen(rng, x):
    return smooth(rng, x * 10.0 ** rng.uniform(0.5, 2)) - (0, 0, 200)


def far_beside(rng, x):
    return smooth(rng, x) * (10.0 ** rng.uniform(1, 4), 1, 1)


def around_the_camera(rng, x):
    return 2 * x @ rotation(rng.integers(1 << 30)) + rng.uniform(-0.3, 0.3, 3)


def through_the_near_plane(rng, x):
    return smooth(rng, x) + (0, 0, 2.4)


SHAPES = [smooth, inside_out, crumpled, soup, flat, small, lattice, off_screen, far_beside, around_the_camera, through_the_near_plane]
SPHERE = icosphere(2)
MESHES = {"sphere": (SPHERE.positions, SPHERE.faces), "icosahedron": (BALL, FACES), "open": (BALL, FACES[2:]),
          "closed and open": (np.concatenate([BALL, BALL + 0.5]), np.concatenate([FACES, FACES[3:9] + len(BALL)]))}


def to_clip(points):
    return points if points.shape[1] == 4 else project(points, SIZE, NEAR)


@pytest.mark.parametrize("mesh", MESHES)
def test_half_of_the_faces_cover_what_all_do(gpu, mesh):
    positions, faces = MESHES[mesh]
    with gpu.open(program_of(Topology(faces, len(positions)))) as session:
        for shape in SHAPES:
            rng, some = np.random.default_rng(len(shape.__name__)), 0
            for _ in range(12):
                session.set("clip", np.concatenate([to_clip(shape(rng, positions)) for _ in range(VIEWS)]))
                expected, found = session.get("all"), session.get("half")
                np.testing.assert_array_equal(found, expected, err_msg=shape.__name__)
                some += expected.sum()
            assert some > 20, f"{shape.__name__} says nothing"
    gpu.silent()


# That half is drawn, and when not


def covered(clip, closed, behind, views):
    """The op on one triangle in each view, said to be of a closed surface or not: it believes it."""
    return apply("rasterize_covered", clip, constant_table(np.array([(0, 1, 2, closed)])), constant_table(np.array([behind])), views=views,
                 extent=Atlas(*SIZE, views, views).extent, vertices=3, face_count=1, near=NEAR, cell_w=SIZE[0], cell_h=SIZE[1],
                 columns=views)


@pytest.mark.parametrize("closed, behind, drawn", [(1, 0, (1, 0)), (0, 0, (1, 1)), (1, 3, (1, 1))])
def test_faces_turned_away_are_left_out_of_what_is_closed_and_before_the_near_plane(gpu, closed, behind, drawn):
    """One triangle and its mirror image."""
    p = Program()
    clip = p.input("clip", Layout("table", "vec4", count=6))
    p.plan("draw", {}, {"front": (covered(clip, closed, behind, 2), Layout("atlas", "int", *SIZE, 2, 2))})
    one = np.array([(-0.9, -0.8, FAR / 2, 1.0), (0.9, -0.7, FAR / 2, 1.0), (0.1, 0.9, FAR / 2, 1.0)]) * (1, 1, 1 / FAR, 1)
    with gpu.open(p) as session:
        session.set("clip", np.concatenate([one, one * (-1, 1, 1, 1)]))
        pixels = (session.get("front") >= 0).sum(axis=(1, 2))
    assert tuple((pixels > 200).astype(int)) == drawn and set(pixels[pixels <= 200]) <= {0}


def test_a_face_turned_away_by_less_than_rounding_is_drawn(gpu):
    """Its corners are moved to the grid of corners by the device, which may turn it round."""
    p = Program()
    clip, image = p.input("clip", Layout("table", "vec4", count=3)), Layout("atlas", "int", *SIZE, 1, 1)
    p.plan("draw", {}, {"closed": (covered(clip, 1, 0, 1), image), "open": (covered(clip, 0, 0, 1), image)})
    rng, turned = np.random.default_rng(4), 0
    with gpu.open(p) as session:
        for _ in range(300):
            ends = rng.uniform(-0.9, 0.9, (2, 2))
            middle = ends.mean(0) + rng.normal(scale=0.008, size=2) / SIZE
            session.set("clip", np.append(np.array([ends[0], ends[1], middle]), np.tile([0.5, 1.0], (3, 1)), 1))
            found, expected = session.get("closed"), session.get("open")
            np.testing.assert_array_equal(found, expected)
            turned += (expected >= 0).any()
    assert turned > 5


def test_the_far_plane_cuts_no_silhouette(gpu):
    """What lies behind it is drawn; cut surfaces would not be closed."""
    p, atlas = Program(), Atlas(*SIZE, 1, 1)
    clip = p.input("clip", Layout("table", "vec4", count=len(BALL)))
    front = rasterized(clip, Topology(FACES, len(BALL)), atlas, Softness(), 3.0, faces=False).front
    p.plan("draw", {}, {"front": (front, Layout("atlas", "int", *SIZE, 1, 1))})
    with gpu.open(p) as session:
        masks = []
        for far in (1e3, 3.5):
            x = project(0.8 * BALL - (0, 0, 4.5), SIZE, 3.0)
            x[:, 2] = far * (x[:, 3] - 3.0) / (far - 3.0)
            session.set("clip", x)
            masks.append(session.get("front") >= 0)
    assert masks[0].sum() > 100
    np.testing.assert_array_equal(*masks)
