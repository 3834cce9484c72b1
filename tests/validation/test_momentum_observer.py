"""The momentum observer shows the torque of contacts, in MuJoCo too, at the stated rate of false alarms."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from support.models_with_chosen_parameters import FloatArray, drives, from_standard, made_up
from support.oracles import Motion, arm, fourier_motion, pinocchio_torque

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.export import to_c_header, to_cpp_header, to_mjcf
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing, Recording, recording_from_arrays
from dynident.robot import compute_tool_jacobian
from dynident.validation.contact_detection import ContactDetection, calibrate_contact_detection
from dynident.validation.momentum_observer import MomentumObserver, ObservedContacts

ROBOT = arm("ur10")
RATE = 500.0
STEPS = 2
"""Steps of the simulation a sample."""
HYSTERESIS = EffectChoice("presliding", (), (("d0", 0.01), ("law", 1.0)))
PLAIN = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))


@cache
def known() -> Identification:
    """An arm whose links, rotors and friction are those of its description."""
    return from_standard(ROBOT, drives(ROBOT))


def motor_torque(motion: Motion) -> FloatArray:
    values = drives(ROBOT)
    rotor, dry, viscous = (np.array([values[f"{name}{j + 1}"] for j in range(ROBOT.n)]) for name in ("Ia", "Fc", "Fv"))
    links = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
    return links + rotor * motion.ddq + dry * np.sign(motion.dq) + viscous * motion.dq


def test_the_residual_is_the_torque_of_a_contact_behind_a_low_pass() -> None:
    motion = fourier_motion(ROBOT, 4.0, RATE, 3)
    contact = np.where(motion.t[:, None] > 2.0, np.array([12.0, -9.0, 5.0, 1.0, -2.0, 0.5]), 0.0)
    observed = MomentumObserver(known(), 1.0 / RATE).observe(motion.q, motor_torque(motion) - contact)
    before, after = (motion.t > 1.0) & (motion.t < 2.0), motion.t > 2.3
    # Where a joint reverses, sign(q̇) is wrong for the delay of the low-pass.
    assert np.median(np.abs(observed.residual[before]), axis=0).max() < 0.1
    np.testing.assert_allclose(np.median(observed.residual[after], axis=0), contact[-1], atol=0.15)
    rising = observed.residual[(motion.t > 2.0)][: round(MomentumObserver(known(), 1.0 / RATE).within * RATE)]
    assert 0.7 < rising[-1, 0] / contact[-1, 0] < 0.9


def test_samples_give_the_same_residual_one_by_one() -> None:
    motion = fourier_motion(ROBOT, 0.3, RATE, 4)
    tau = motor_torque(motion)
    observer = MomentumObserver(known(), 1.0 / RATE)
    whole = observer.observe(motion.q, tau).residual
    observer.reset()
    one_by_one = [observer.step(q, torque) for q, torque in zip(motion.q, tau, strict=True)]
    np.testing.assert_allclose(one_by_one, whole, rtol=1e-9, atol=1e-9)


def draw_thresholds(observed: ObservedContacts) -> ContactDetection:
    """Thresholds that about half of the samples are above, in every class; one joint has none."""
    speeds = np.quantile(np.abs(observed.dq), (0.3, 0.6), axis=0).T
    thresholds = np.median(np.abs(observed.residual), axis=0)[:, None] * np.array([0.8, 1.2, 0.9, 1.1])
    thresholds[4] = np.inf
    contact = ContactDetection(10.0, 1 / 15, 1.0, 30.0, speeds, thresholds, 60.0)
    share = contact.find_contacts(observed).mean(axis=0)
    assert ((share > 0.1) & (share < 0.9) | (np.arange(ROBOT.n) == 4)).all()
    assert observed.slow.any()
    assert not observed.slow.all()
    return contact


SANITIZED = "-O1 -fsanitize=address,undefined"


@pytest.mark.parametrize(
    ("model", "language", "compiler", "options"),
    [
        *((model, "c", "gcc", SANITIZED) for model in ("known", "hysteresis", "a sample that is not a number")),
        *((model, "cpp", "g++", SANITIZED) for model in ("known", "hysteresis", "a sample that is not a number")),
        # With these options compilers may take it for granted that every value is a number.
        *(("a sample that is not a number", "c", compiler, "-O2 -ffast-math") for compiler in ("gcc", "clang")),
    ],
)
def test_the_exported_headers_have_the_same_observer(
    model: str, language: str, compiler: str, options: str, tmp_path: Path
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"NO {compiler}: the observer of the {language} header is not tested with it here")
    identified = made_up(ROBOT, ("rigid_body", "coulomb", HYSTERESIS)) if model == "hysteresis" else known()
    motion = fourier_motion(ROBOT, 0.5, RATE, 4)
    tau = motor_torque(motion)
    observed = MomentumObserver(identified, 1.0 / RATE).observe(motion.q, tau)
    contact = draw_thresholds(observed)
    if model == "a sample that is not a number":
        tau[60] = np.nan
        observed = MomentumObserver(identified, 1.0 / RATE).observe(motion.q, tau)
        # The residual has no value from there on, which must not look like no contact.
        assert contact.find_contacts(observed)[60:].all()
    expected = observed.residual
    file = to_c_header(identified, contact) if language == "c" else to_cpp_header(identified, contact)
    name = Path(file.name).stem
    (tmp_path / file.name).write_bytes(file.content)
    begin = {
        "c": f"{name}_parameters p = {name}_identified(); {name}_observer o; {name}_observer_start(&o);",
        "cpp": f"{name}::Model model; auto o = {name}::Model::start_observer(); std::array<double, 6> a, b;",
    }[language]
    step = {
        "c": f"{name}_observe(&p, &o, q, tau, 0.002, 30.0); fwrite(o.residual, sizeof(double), 6, stdout); "
        f"int found[6]; {name}_find_contacts(&o, found); fwrite(found, sizeof(int), 6, stdout);",
        "cpp": "for (int j = 0; j < 6; ++j) { a[j] = q[j]; b[j] = tau[j]; } "
        "fwrite(model.observe(o, a, b, 0.002, model.contact_gain).data(), sizeof(double), 6, stdout); "
        "fwrite(model.find_contacts(o).data(), sizeof(int), 6, stdout);",
    }[language]
    loop = "fread(q, sizeof(double), 6, stdin) == 6 && fread(tau, sizeof(double), 6, stdin) == 6"
    source = tmp_path / f"main.{language}"
    source.write_text(
        f'#include <stdio.h>\n#include "{file.name}"\nint main(void)\n{{\n    double q[6], tau[6];\n    {begin}\n'
        f"    while ({loop}) {{ {step} }}\n    return 0;\n}}\n"
    )
    standard = "-std=c99" if language == "c" else "-std=c++17"
    strict = [standard, "-Wall", "-Wextra", "-Werror", "-pedantic"]
    command = [compiler, *strict, *options.split(), str(source), "-o", str(tmp_path / "main"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    given = np.column_stack([motion.q, tau]).tobytes()
    answer = subprocess.run([tmp_path / "main"], input=given, capture_output=True, check=True).stdout
    found = np.frombuffer(answer, dtype=[("residual", float, 6), ("contacts", np.intc, 6)])
    np.testing.assert_allclose(found["residual"], expected, rtol=0, atol=1e-9 * np.nanmax(np.abs(expected)))
    np.testing.assert_array_equal(found["contacts"], contact.find_contacts(observed))
    assert " ".join(contact.describe().split()) in " ".join(file.content.decode().replace("\n *", " ").split())


def test_what_an_observer_cannot_know_is_refused() -> None:
    with pytest.raises(DynidentError, match="temperature"):
        MomentumObserver(made_up(arm("scara"), ("rigid_body", "temperature_friction")), 1e-3)
    for words in ({"period": 0.0}, {"period": 1e-3, "gain": -1.0}):
        with pytest.raises(DynidentError, match="above 0"):
            MomentumObserver(known(), **words)
    with pytest.raises(DynidentError, match="a value a joint"):
        MomentumObserver(known(), 1e-3).observe(np.zeros((3, 2)), np.zeros((3, 2)))
    for rows, others in ((0, 0), (5, 1), (1, 5)):
        with pytest.raises(DynidentError, match="as many of both"):
            MomentumObserver(known(), 1e-3).observe(np.zeros((rows, ROBOT.n)), np.zeros((others, ROBOT.n)))
    with pytest.raises(DynidentError, match="false_alarms"):
        calibrate_contact_detection(known(), [], false_alarms_per_hour=0.0)


@dataclass(frozen=True)
class Contact:
    """A force (3,) in N at the origin of the last link, in the base frame, from `start` s on."""

    start: float
    force: FloatArray


class Cell:
    """The arm in MuJoCo under joint control along a motion, with noise of encoders and torques."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(to_mjcf(known()).content.decode())
        self.link = self.model.nbody - 1

    def record(self, seed: int, duration: float, contacts: tuple[Contact, ...] = (), length: float = 0.3) -> Recording:
        """A motion with contacts that last for `length` s each."""
        motion, rng = fourier_motion(ROBOT, duration, RATE, seed), np.random.default_rng(seed)
        data = mujoco.MjData(self.model)
        data.qpos, data.qvel = motion.q[0], motion.dq[0]
        # What a controller knows: the torque of the motion, and stiff joints.
        feed = motor_torque(motion)
        inertia = np.array([30.0, 30.0, 10.0, 2.0, 2.0, 2.0])
        q, tau = np.empty_like(motion.q), np.empty_like(motion.q)
        pending, end = list(contacts), 0.0
        for k, time in enumerate(motion.t):
            error, rate = motion.q[k] - data.qpos, motion.dq[k] - data.qvel
            data.ctrl = np.clip(feed[k] + inertia * (900.0 * error + 60.0 * rate), *self.model.actuator_ctrlrange.T)
            if pending and time >= pending[0].start:
                # The posture hardly changes while a contact lasts.
                contact = pending.pop(0)
                data.qfrc_applied, end = contact.force @ compute_tool_jacobian(ROBOT, data.qpos[None])[0], time + length
            if time >= end:
                data.qfrc_applied = 0.0
            q[k], tau[k] = data.qpos, data.ctrl
            mujoco.mj_step(self.model, data, STEPS)
        q += rng.normal(0.0, 1e-5, q.shape)
        tau += rng.normal(0.0, 0.3, tau.shape)
        return recording_from_arrays(motion.t, q, tau, joint_names=ROBOT.joint_names, name=f"run{seed}")


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell()


@pytest.fixture(scope="module")
def calibrated(cell: Cell) -> tuple[Identification, ContactDetection]:
    choices = IdentificationChoices(PLAIN, preprocessing=Preprocessing(20.0, 10.0, 20))
    identified = identify(ROBOT, [cell.record(11, 30.0)], [], choices)
    detection = calibrate_contact_detection(identified, [cell.record(12, 60.0)], false_alarms_per_hour=30.0)
    assert detection is not None
    return identified, detection


def observe(identified: Identification, recording: Recording) -> ObservedContacts:
    observer = MomentumObserver(identified, 1.0 / recording.sampling_rate)
    (rows,) = recording.source.rows(0, recording.n_samples, recording.n_samples)
    return observer.observe(rows.q, rows.tau)


@pytest.mark.slow
def test_contacts_of_the_stated_force_are_found_in_the_stated_time(
    cell: Cell, calibrated: tuple[Identification, ContactDetection]
) -> None:
    identified, detection = calibrated
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    contacts = tuple(
        Contact(2.0 + k + rng.uniform(0.0, 0.2), detection.force * unit) for k, unit in enumerate(directions)
    )
    recording = cell.record(13, 43.0, contacts)
    observed = observe(identified, recording)
    alarms = detection.find_contacts(observed).any(axis=1)
    t = np.arange(len(alarms)) / RATE
    detected = [alarms[(t >= c.start) & (t <= c.start + detection.within + 1.5 / RATE)].any() for c in contacts]
    assert np.mean(detected) >= 0.9
    assert detection.force < 60.0
    assert f"{1e3 * detection.within:.0f} ms" in detection.describe()


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated(cell: Cell, calibrated: tuple[Identification, ContactDetection]) -> None:
    identified, detection = calibrated
    count, seconds = 0, 0.0
    for seed in (20, 21):
        recording = cell.record(seed, 90.0)
        observed = observe(identified, recording)
        later = ObservedContacts(observed.residual[500:], observed.q[500:], observed.dq[500:], observed.slow[500:])
        count += detection.count_alarms(later, 1.0 / RATE)
        seconds += 90.0
    # Twice as many as stated are allowed.
    assert count <= 2 * detection.false_alarms_an_hour * seconds / 3600.0
