"""Fig. 7 and 8: the led beam, the dancer and their glyphs; the figures themselves are drawn by test_studies.py."""

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.core.errors import OptionError
from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views, write_film
from paper_figures.glyphs import arrow, axes, joined, rod, sphere
from studies import dancing_character as study

CORNERS = np.array([[0.0, -0.1, 0.0], [1.0, -0.1, 0.0], [1.0, 0.1, 0.0], [0.0, 0.1, 0.0]])
STRIP = (CORNERS, np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture(scope="module", params=[pytest.param("manipulation", marks=pytest.mark.slow)])
def beam(quick_study, request):
    return StudyResult.load(quick_study(request.param), request.param)


@pytest.fixture(scope="module")
def dancer():
    return study.skeleton.Skeleton()


# ---- Fig. 7 ----


def test_beam_meets_its_targets(beam):
    tip, rest = int(beam.arrays["tip"]), beam.arrays["rest"]
    for number, row in enumerate(beam.findings["rows"], start=1):
        assert row["status"] == "converged"
        assert row["motion_status"] == "completed"
        assert row["motion_residual"] < 1e-6
        assert row["settled_apart"] < 1e-3
        if row["position"] is not None:
            for end in (beam.arrays[f"case_{number}_mwts"], beam.arrays[f"case_{number}_motion"][-1]):
                assert end[tip] == pytest.approx(row["position"], abs=1e-6)
            assert np.linalg.norm(row["position"] - rest[tip]) > 0.4
        if row["rotation_vector"] is not None:
            assert beam.arrays[f"case_{number}_turn"] == pytest.approx(row["rotation_vector"], abs=1e-7)


def test_discrete_shells_answer_positions_only(beam):
    for row in beam.findings["rows"]:
        assert ("error" in row) == (row["position"] is not None)
        if "error" in row:
            assert row["ds_status"] == "converged"
            assert row["error"] < 0.35


# ---- Fig. 8 ----


@pytest.mark.slow
def test_skeleton_keeps_its_bones_and_its_planted_feet(dancer):
    assert len(dancer.rest) >= 12
    assert dancer.duration >= 6.0
    bones = [(joint, parent) for joint, parent in dancer.parents.items() if parent]
    poses = [dancer.pose(float(time)) for time in np.arange(0.0, dancer.duration, 0.05)]
    for joint, parent in bones:
        lengths = [np.linalg.norm(pose[joint].position - pose[parent].position) for pose in poses]
        assert lengths == pytest.approx([np.linalg.norm(dancer.rest[joint] - dancer.rest[parent])] * len(poses))
    ankles = np.array([[pose[f"ankle_{side}"].position for side in ("left", "right")] for pose in poses])
    assert ankles[..., 2].min() > 0.099
    # A foot stands at every time but for the few moments of a landing.
    assert np.mean(ankles[..., 2].min(axis=1) < 0.105) > 0.8
    # Legs hang on what the pelvis carries: thigh and shin point from joint to joint.
    for pose in poses[::7]:
        below = pose["hip_left"].rotation.apply(dancer.rest["knee_left"] - dancer.rest["hip_left"])
        assert pose["knee_left"].position - pose["hip_left"].position == pytest.approx(below)


@pytest.mark.slow
def test_dance_is_lively(dancer):
    poses = [dancer.pose(float(time)) for time in np.arange(0.0, dancer.duration, 0.05)]
    wrists = np.array([pose["wrist_left"].position for pose in poses])
    assert np.ptp(wrists[:, 2]) > 0.8
    headings = np.unwrap([pose["pelvis"].rotation.as_euler("zyx")[0] for pose in poses])
    assert np.degrees(headings[-1]) == pytest.approx(360.0, abs=30.0)


def test_tubes_are_open_and_near_equilateral():
    for garment in study.GARMENTS:
        tube = study.clothes.Tube(garment.profile, study.SPACING, garment.shift)
        mesh = tube.mesh
        assert 300 <= len(mesh.vertices) <= 1500
        # Two boundary loops, of a ring each; an annulus.
        assert len(mesh.boundary_vertices) == tube.counts[0] + tube.counts[-1]
        assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 0
        assert np.quantile(mesh.edge_lengths, 0.1) > 0.4 * study.SPACING
        assert mesh.edge_lengths.max() < 2.0 * study.SPACING
        for height, *_ in garment.led:
            middle = mesh.vertices[tube.patch(height)].mean(axis=0)
            assert middle == pytest.approx([garment.shift, 0.0, height], abs=0.02)


def test_dancer_wears_its_shells(dancer, quick_study):
    result = StudyResult.load(quick_study("dancing_character"), "dancing_character")
    assert [row["status"] for row in result.findings["rows"]] == ["completed"] * 4
    for garment, row in zip(study.GARMENTS, result.findings["rows"], strict=True):
        assert row["position_residual"] < 1e-6
        assert row["orientation_residual"] < 1e-6
        assert row["constraints"] == 2 * len(garment.led)
        assert abs(row["largest_area_change"]) < 0.1
        # Held rings go with their joint, led ones with theirs.
        tube = study.clothes.Tube(garment.profile, study.QUICK_SPACING, garment.shift)
        rest, end = tube.mesh.vertices, result.arrays[f"{garment.name}_positions"][-1]
        pose = dancer.pose(float(result.arrays["times"][-1]))
        held = (rest[:, 2] >= garment.held[0]) & (rest[:, 2] <= garment.held[1])
        assert len(np.unique(rest[held, 2])) >= 2
        joint = pose[garment.joint]
        placed = joint.position + joint.rotation.apply(rest[held] - dancer.rest[garment.joint])
        assert end[held] == pytest.approx(placed, abs=1e-5)
        for height, first, second in garment.led:
            ring = tube.patch(height)
            half = (pose[first].rotation.inv() * pose[second].rotation).as_rotvec() / 2.0
            turn = pose[first].rotation * Rotation.from_rotvec(half)
            goal = pose[first].position + turn.apply(rest[ring].mean(axis=0) - dancer.rest[first])
            assert end[ring].mean(axis=0) == pytest.approx(goal, abs=1e-5)


# ---- glyphs and films of several surfaces ----


def test_glyphs_are_closed_and_where_they_should_be():
    center, start, end = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]), np.array([0.0, -2.0, 1.0])
    ball = sphere(center, 0.5)
    assert np.linalg.norm(ball[0] - center, axis=1) == pytest.approx(np.full(len(ball[0]), 0.5))
    stick, pointer = rod(start, end, (0.2, 0.1)), arrow(start, end, 0.05)
    assert np.ptp(stick[0], axis=0) == pytest.approx([0.4, 2.3, 0.4])
    assert pointer[0][np.argmin(pointer[0][:, 1])] == pytest.approx(end)
    for shape in (ball, stick, pointer):
        assert ms.TriangleMesh(*shape).boundary_vertices.size == 0
    vertices, faces = joined([ball, stick])
    assert ms.TriangleMesh(vertices, faces).components.max() == 1


def test_axes_point_where_the_frame_does():
    turned = axes([1.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2.0], 0.3)
    tips = [surface.vertices[np.linalg.norm(surface.vertices - [1, 0, 0], axis=1).argmax()] for surface in turned]
    assert np.array(tips) == pytest.approx(np.array([[1.0, 0.3, 0.0], [0.7, 0.0, 0.0], [1.0, 0.0, 0.3]]))
    reds = [surface.color for surface in turned]
    assert len(set(reds)) == 3


def test_surfaces_without_lines(tmp_path, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    darkest = []
    for lined in (True, False):
        view = View([ShadedSurface(*STRIP, "#dddddd", lined=lined)])
        path = draw_views([view], tmp_path / f"{lined}.png", size=(300, 200))
        darkest.append(imread(path)[..., :3].min())
    assert darkest[0] < 0.5 < 0.6 < darkest[1]


def test_film_of_several_surfaces(tmp_path, monkeypatch):
    import imageio_ffmpeg

    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    vertices, faces = STRIP
    surfaces = [ShadedSurface(vertices, faces, "red"), ShadedSurface(vertices - [0, 0, 0.3], faces, "blue")]
    motion = np.stack([vertices + np.array([0.0, 0.0, 0.1 * frame]) for frame in range(4)])
    path = write_film(tmp_path / "f.mp4", surfaces, [motion, None], size=(160, 120))
    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] == 4
    refused = [([motion], "one entry a surface"), ([motion, motion[:2]], "same number"), ([None, None], "frames"),
               ([motion, motion[:, :3]], "4 vertices")]  # fmt: skip
    for motions, message in refused:
        with pytest.raises(OptionError, match=message):
            write_film(tmp_path / "g.mp4", surfaces, motions)
    assert [file.name for file in tmp_path.iterdir()] == ["f.mp4"]
