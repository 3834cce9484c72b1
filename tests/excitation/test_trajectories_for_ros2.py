"""A trajectory as a ROS 2 JointTrajectory message, read by a YAML parser."""

from __future__ import annotations

import numpy as np
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.excitation.design_files import format_joint_trajectory

NUMBERS = st.floats(-1e6, 1e6, allow_nan=False)


@settings(max_examples=50, deadline=None)
@given(
    names=st.lists(st.text(st.characters(codec="ascii", min_codepoint=32), min_size=1), min_size=2, max_size=2),
    rows=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=5),
    start=st.floats(0, 1e4),
    rate=st.floats(1, 4000),
)
def test_every_number_and_name_arrives_as_it_was(names, rows, start, rate):
    q = np.array(rows)
    t = start + np.arange(len(q)) / rate
    message = yaml.safe_load("".join(format_joint_trajectory(names, t, q, 2 * q, -q)))
    assert message["joint_names"] == names
    for k, point in enumerate(message["points"]):
        assert all(isinstance(value, float) for value in point["positions"])
        np.testing.assert_allclose(point["positions"], q[k], rtol=1e-11)
        np.testing.assert_allclose(point["velocities"], 2 * q[k], rtol=1e-11)
        np.testing.assert_allclose(point["accelerations"], -q[k], rtol=1e-11)
        stamp = point["time_from_start"]
        assert 0 <= stamp["nanosec"] < 10**9
        assert abs(stamp["sec"] + 1e-9 * stamp["nanosec"] - (t[k] - t[0])) < 1e-9 + 1e-12 * start
