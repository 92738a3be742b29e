"""The workspace map and the solids against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from rm501_host.config import load_config
from rm501_host.config.schema import BoxSection, KeepOutSection
from rm501_host.kinematics import Arm, KinematicsError, SolidRadii, capsules, clearances
from rm501_host.kinematics.solids import hand_capsule, segment_box_distance
from rm501_host.kinematics.workspace import reachable_pitches, workspace_map
from tests.support.kinematics import random_joints

ARM = Arm.from_config(load_config())
OFFSET = ARM.with_tool(20.0, (10.0, -15.0))


@pytest.mark.parametrize("arm", [ARM, OFFSET], ids=["plain", "offset"])
def test_every_place_that_joints_reach_is_on_the_map(arm: Arm) -> None:
    """Forward kinematics of random joints lands in a cell that is reachable there or next to it."""
    step_mm, step_deg = 10.0, 5.0
    count = int(np.ceil(arm.geometry.reach_mm / step_mm)) + 1
    r = np.arange(-count, count + 1) * step_mm
    z = arm.geometry.d1_mm + np.arange(-count, count + 1) * step_mm
    section = workspace_map(arm, r, z, np.arange(-180.0, 300.0, step_deg))
    q = random_joints(arm, 20_000, seed=80, margin_deg=0.5)
    q[:, 4] = 0.0
    q[:, 0] = 0.0
    positions, _ = arm.fk_batch(q)
    pitch = q[:, 1:4].sum(axis=1)
    cells = (
        np.rint((positions[:, 0] - r[0]) / step_mm).astype(int),
        np.rint((positions[:, 2] - z[0]) / step_mm).astype(int),
        np.rint((pitch + 180.0) / step_deg).astype(int),
    )
    grown = section.reachable.copy()
    for axis in range(3):
        grown |= np.roll(grown, 1, axis) | np.roll(grown, -1, axis)
    assert grown[cells].mean() > 0.99  # the rest is where the workspace is thinner than a cell
    # and nothing is on it that the closed form does not reach, judged by forward kinematics
    rows, columns, pitches = (index[::997] for index in np.nonzero(section.reachable))
    for a, b, c in zip(rows, columns, pitches, strict=True):
        _, ty, _ = arm.geometry.tcp_mm
        result = arm.ik((r[a], -ty, z[b]), float(section.pitch_deg[c]), 0.0)
        assert any(solution.in_limits and abs(solution.q_deg[0]) < 1e-6 for solution in result.solutions) or a == count


@pytest.mark.parametrize("arm", [ARM, OFFSET], ids=["plain", "offset"])
def test_manipulability_of_the_map_is_the_best_over_the_pitches(arm: Arm) -> None:
    r, z, pitch = np.array((300.0, 320.0)), np.array((200.0, 210.0)), np.arange(-90.0, 181.0, 10.0)
    section = workspace_map(arm, r, z, pitch)
    best = 0.0
    for angle in pitch:
        result = arm.ik((320.0, -arm.geometry.tcp_mm[1], 210.0), angle, 0.0)
        for solution in result.solutions:
            if solution.in_limits:
                best = max(best, arm.manipulability(solution.q_deg, section.length_mm))
    assert section.manipulability[1, 1] == pytest.approx(best)
    assert section.area_mm2 == 4 * 200.0
    with pytest.raises(KinematicsError, match="two radii"):
        workspace_map(arm, r[:1], z, pitch)


RADII = {"upper_arm_radius_mm": 60.0, "forearm_radius_mm": 50.0, "hand_radius_mm": 35.0}


def test_reachable_pitches_of_a_point() -> None:
    pitches = reachable_pitches(ARM, (300.0, 50.0, 200.0))
    for angle in np.arange(-180.0, 180.0):
        assert (angle in pitches) == ARM.ik((300.0, 50.0, 200.0), angle, 0.0).ok
    assert not len(reachable_pitches(ARM, (600.0, 0.0, 200.0)))


def test_solids_lie_along_the_links() -> None:
    q = random_joints(OFFSET, 50, seed=81, margin_deg=0.0)
    solids = capsules(OFFSET.geometry, q)
    for row, angles in enumerate(q):
        chain = OFFSET.frames(angles)
        np.testing.assert_allclose(solids.starts[row, 1], chain[1, :3, 3], atol=1e-9)
        np.testing.assert_allclose(solids.ends[row, 1], chain[2, :3, 3], atol=1e-9)
        np.testing.assert_allclose(solids.ends[row, 2], chain[3, :3, 3], atol=1e-9)
        tip, wrist = chain[6, :3, 3], chain[4, :3, 3]
        start, end, radius = hand_capsule(OFFSET.geometry, angles)
        np.testing.assert_allclose(start, wrist, atol=1e-9)
        assert np.linalg.norm(tip - end) == pytest.approx(radius)  # its cap ends at the fingertips
        np.testing.assert_allclose(np.cross(tip - wrist, end - wrist), 0.0, atol=1e-6)


def test_distance_of_segment_and_box_against_brute_force() -> None:
    rng = np.random.default_rng(82)
    starts, ends = rng.uniform(-3, 3, (2, 400, 3))
    ends[:20] = starts[:20]  # points
    ends[20:60, 0] = starts[20:60, 0]  # parallel to a face
    low, high = np.array((-1.0, -0.5, -0.2)), np.array((0.5, 0.4, 1.5))
    found = segment_box_distance(starts, ends, low, high)
    t = np.linspace(0.0, 1.0, 4001)[None, :, None]
    points = starts[:, None, :] * (1 - t) + ends[:, None, :] * t
    gaps = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=2)
    brute = gaps.min(axis=1)
    assert (found <= brute + 1e-12).all()
    assert np.abs(found - brute).max() <= 2e-3
    # the place of the brute minimum, refined
    best = np.clip(gaps.argmin(axis=1) / 4000.0, 0.0005, 0.9995)
    fine = np.linspace(-0.0005, 0.0005, 2001)[None, :, None] + best[:, None, None]
    points = starts[:, None, :] * (1 - fine) + ends[:, None, :] * fine
    refined = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=2).min(axis=1)
    assert np.abs(found - refined).max() <= 1e-6


def test_clearances_name_what_is_near() -> None:
    keep_out = KeepOutSection(
        **RADII,
        table_z_mm=0.0,
        boxes=(BoxSection(name="post", min_mm=(300.0, 90.0, 0.0), max_mm=(340.0, 130.0, 400.0)),),
    )
    path = np.array([ARM.ik((320.0, y, 100.0), 0.0, 0.0).best.q_deg for y in (-100.0, 0.0, 60.0, 110.0)])  # type: ignore[union-attr]
    found = clearances(capsules(ARM.geometry, path, SolidRadii(hand_mm=20.0)), keep_out)
    assert ("hand", "table") in found.pairs and ("column", "table") not in found.pairs
    hand = found.mm[:, found.pairs.index(("hand", "post"))]
    assert hand[0] == pytest.approx(190.0 - 20.0)
    assert hand[1] == pytest.approx(90.0 - 20.0)
    assert hand[2] == pytest.approx(30.0 - 20.0)
    assert hand[3] == pytest.approx(-20.0)
    row, solid, zone, distance = found.worst()
    assert (row, zone) == (3, "post")
    assert distance < 0 and solid in ("hand", "forearm", "upper arm")
    table = found.mm[:, found.pairs.index(("hand", "table"))]
    np.testing.assert_allclose(table, 100.0)  # the fingertips are at z = 100, the hand's cap touches them
    with pytest.raises(KinematicsError, match="no keep-out zone"):
        clearances(capsules(ARM.geometry, path), KeepOutSection(**RADII)).worst()
    with pytest.raises(KinematicsError, match="forearm"):
        SolidRadii(forearm_mm=0.0)
