"""Read what a column's name says: signal, joint, unit, measured or commanded; the vocabulary of loggers and makers."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, takewhile
from types import MappingProxyType
from typing import Literal

from dynident.recordings.units import FACTORS, get_signal_of_unit

Signal = Literal["t", "q", "dq", "ddq", "tau", "current", "effort", "temperature", "segment", "other"]


def _split_words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_WORDS: dict[Signal, frozenset[str]] = {
    "t": _split_words(
        "t time timestamp stamp zeit clock temps tiempo tempo ipoc datetime epoch elapsed время 时间 時間 시간"
    ),
    "q": _split_words(
        "q pos position positions angle angles ang theta winkel lage stellung posicion encoder enc jpos qpos "
        "pulse pulses weg угол положение 角度 位置 각도 위치"
    ),
    "dq": _split_words(
        "dq qd vel velocity velocities speed omega qdot thetadot dtheta geschwindigkeit drehzahl jvel qvel spd speeds "
        "скорость 速度 속도"
    ),
    "ddq": _split_words("ddq qdd acc accel acceleration accelerations qddot beschleunigung"),
    "tau": _split_words(
        "tau torque torques trq moment moments drehmoment mom tq jtrq qfrc момент 力矩 扭矩 转矩 トルク 토크"
    ),
    "current": _split_words("current currents cur curr amp amps ampere strom iq i ток 电流 電流 전류"),
    "effort": _split_words("effort efforts eff load loads"),
    "temperature": _split_words("temp temperature temperatur temperatures"),
    "segment": _split_words("segment run episode"),
}
_OTHER = _split_words(
    "tcp cartesian cart force fx fy fz quaternion quat digital analog io state_id safety voltage volt "
    "power payload gripper error err residual bits"
)
_END_EFFECTOR, _AXES = _split_words("ee eef"), _split_words("x y z rx ry rz roll pitch yaw w")
_STATES = _split_words("status mode")  # as the last word; before a signal they are the message's
_WAVES = {"cos": "sin", "sin": "cos", "cosine": "sine", "sine": "cosine"}
"""Words that say that a column is the sine or the cosine of an angle, where the other of the two is there, too."""
_COMMANDED = _split_words(
    "d cmd command commanded commands target des desired ref reference set setpoint setpoints sp soll goal nominal "
    "planned action ipo interpolated ctrl computed 指令 命令 目标 目標 给定 설정 목표"
)
_MEASURED = _split_words("act actual meas measured ist real feedback fb fbk msr 实际 実際 反馈 当前 실제 현재")
_EXTERNAL = _split_words("ext external contact extern")
_COMPENSATED = _split_words("gravity grav compensated gravcomp comp")
_MOTOR = _split_words("motor mot rotor")

_UNITS = {
    "rad": "rad", "deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "grad": "deg", "mrad": "mrad",
    "turn": "rev", "turns": "rev", "0.1%": "permille", "0.1 %": "permille", "1/1000": "permille",
    "rev": "rev", "m": "m", "mm": "mm", "cm": "cm", "rad/s": "rad/s", "deg/s": "deg/s", "°/s": "deg/s", "rpm": "rpm",
    "1/min": "rpm", "u/min": "rpm", "rev/s": "rev/s", "mrad/s": "mrad/s", "m/s": "m/s", "mm/s": "mm/s", "cm/s": "cm/s",
    "rad/s^2": "rad/s^2", "deg/s^2": "deg/s^2", "rad/s2": "rad/s^2", "deg/s2": "deg/s^2", "nm": "N m", "n m": "N m",
    "n*m": "N m", "n·m": "N m", "n.m": "N m", "mnm": "mN m", "mn m": "mN m", "knm": "kN m", "ncm": "N cm",
    "nmm": "N mm", "n": "N", "mn": "mN", "kn": "kN", "a": "A", "ma": "mA", "amp": "A", "ampere": "A", "s": "s",
    "sec": "s", "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "μs": "us", "ns": "ns", "permille": "permille",
    "‰": "permille", "promille": "permille", "%": "percent", "percent": "percent", "degc": "degC", "°c": "degC",
    "pct": "percent", "prozent": "percent",
    "k": "K", "min": "min", "h": "h", "kgfcm": "kgf cm", "kgcm": "kgf cm", "kgfm": "kgf m", "gfcm": "gf cm",
    "lbfft": "lbf ft", "ftlbf": "lbf ft", "lbfin": "lbf in", "inlbf": "lbf in", "ozfin": "ozf in", "ozin": "ozf in",
    "kgf": "kgf", "lbf": "lbf", "gon": "gon", "mdeg": "mdeg", "arcmin": "arcmin", "arcsec": "arcsec", "cnm": "cN m",
    "danm": "daN m", "рад": "rad", "град": "deg", "н·м": "N m", "нм": "N m", "度": "deg", "d": "d", "day": "d",
    "days": "d", "um": "um", "µm": "um", "μm": "um", "弧度": "rad", "度/秒": "deg/s", "弧度/秒": "rad/s", "牛米": "N m",
    "牛": "N", "毫米": "mm", "秒": "s", "毫秒": "ms", "微秒": "us", "安": "A",
}  # fmt: skip
_SUFFIXES = _split_words(
    "rad deg degrees mdeg gon arcmin arcsec mrad rev turns mm cm um rpm nm mnm knm ncm a ma s sec ms us ns permille "
    "promille percent pct prozent degc"
)
_SLIDING: tuple[Signal, ...] = ("q", "dq", "ddq", "tau")
_SIGNALS_OF_SLIDING = {unit: signal for signal in _SLIDING for unit in FACTORS[signal, "prismatic"]}
_PAIRS = {("deg", "s"): "deg/s", ("rad", "s"): "rad/s", ("mm", "s"): "mm/s", ("m", "s"): "m/s", ("rev", "s"): "rev/s",
          ("turns", "s"): "rev/s",
          ("degs", ""): "deg/s", ("rads", ""): "rad/s", ("mn", "m"): "mN m", ("n", "m"): "N m"}  # fmt: skip
_MAKER_WORDS = {
    "AIPos": "actual position", "ASPos": "setpoint position", "MACur": "motor current",
    "EIPos": "external axis position", "ESPos": "external axis setpoint position", "MECur": "external axis current",
    "current_as_torque": "gravity compensated torque", "actuator_force": "actuator effort",
    "qfrc_bias": "computed torque", "qfrc_passive": "computed torque", "qfrc_constraint": "computed torque",
    "qfrc_inverse": "computed torque", "pos_estimate": "position turns", "vel_estimate": "velocity turns s",
    "POSJOINTCURRENT": "actual position", "POSJOINTSETPOINT": "setpoint position", "CURRENTJOINTS": "motor current",
    "JTS": "joint torque measured", "EJT": "external joint torque", "DynamicTor": "computed torque",
    "qOut_": "commanded position ", "alphaOut_": "commanded velocity ", "tauOut_": "commanded torque ",
}  # fmt: skip
"""What makers' own words for signals mean: of KUKA's RobotSensorInterface (the axes E1 to E6 are not the robot's), and
of Universal Robots' RTDE, whose currents as torques are without the load of gravity; of MuJoCo, whose actuators' forces
are torques where joints turn, and whose other generalised forces are computed; of ODrive, which counts turns; of
mc_rtc, whose Out goes to the robot; of igus (CRI); and of Doosan, whose JTS are joint torque sensors."""
_OBJECT = re.compile(r"(?<![^\W_])(?:0x(?:6064|606C|6077|6078)|(?:6064|606C|6077|6078)h)(?![^\W_])", re.IGNORECASE)
_OBJECTS = {"6064": "actual position", "606c": "actual velocity", "6077": "actual torque", "6078": "actual current"}
_OF_RATED = ("6077", "6078")
"""Objects of drives on CANopen and EtherCAT (CiA 402): their signals, and those that are in 1/1000 of the rated torque
and current where the name states no other unit."""

_LOGGERS: tuple[tuple[frozenset[str], dict[str, str]], ...] = (
    (
        _split_words("mp ip mt et tsec"),
        {"mp": "measured position", "ip": "interpolated position", "mt": "measured torque", "et": "external torque"},
    ),
)
"""Abbreviations that only a logger's names together tell (pyFRI): words that have to be there, and what they mean."""

PENDANTS = (
    ((("base",), ("shoulder",), ("elbow",), ("wrist", "1"), ("wrist", "2"), ("wrist", "3")), "base, …, wrist 3"),
    *((tuple((letter,) for letter in axes), ", ".join(axes.upper())) for axes in ("slurbt", "sleurbt")),
)
"""What makers' pendants call the joints, and how that is shown."""

_BRACKET = re.compile(r"\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]\s*$")
_ENDING = re.compile(
    r"[_ .\-](mA|mNm|kNm|cNm|daNm|Nm|kgf?[.·*_]?cm|kgf[.·*_]?m|ozf?[.·*_]?in|lbf[.·*_]?(?:in|ft)|kgf|lbf|mrad|rpm|"
    r"permille|promille|percent|pct|ms|us|ns|mm|cm)$",
    re.IGNORECASE,
)
_NUMBER_BEHIND = re.compile(r"[_ .\-]\d+$")
_STRANGE_UNIT = re.compile(r"^(?:[mkµu]?V|mW|W|kW|bar|psi|kPa|counts?|ticks?|LSB|raw|bits?|digits?|inc)$", re.I)
"""Units of what a sensor gives, which only its own constant turns into a torque."""
_UNSPACED = re.compile(
    "|".join(sorted(word for word in {*chain(*_WORDS.values()), *_COMMANDED, *_MEASURED} if word > "\u3000"))
)
"""Words of languages that put no spaces between them."""
_SECOND_DOT = re.compile("(?:(?<![A-Za-z])d|D)Dot")  # dDotQ, qDDot
_PART = re.compile(r"[A-Z]+(?![a-zµ])|[A-Z]?[a-zäöüßµμ]+|\d+|[°‰%]|[^\W\d_A-Za-zäöüßµμ°]+")


@dataclass(frozen=True)
class ColumnName:
    """What a column's name says.

    Parameters
    ----------
    name : str
        The name.
    signal : str or None
        The kind of signal; "other" where it is none of a joint, None where the name does not say.
    unit : str or None
        The unit that the name, or the file, states.
    words : tuple of str
        Its words in small letters, numbers among them.
    numbers : tuple of int
        The numbers in it.
    commanded : bool
        Whether it is called a command.
    measured : bool
        Whether it is called measured.
    external : bool
        Whether it is called external, as torques without the robot's own dynamics are.
    compensated : bool
        Whether it is called gravity-compensated.
    motor : bool
        Whether it is one of a motor.
    link : bool
        Whether it is one of a link, beside the joint's own.
    strange_unit : str
        What stands in brackets behind the name and is no unit of such a signal; "" where nothing does.
    stated : bool
        Whether the user says what the column is, and not its name.
    """

    name: str
    signal: Signal | None
    unit: str | None
    words: tuple[str, ...]
    numbers: tuple[int, ...]
    commanded: bool
    measured: bool
    external: bool
    compensated: bool
    motor: bool
    link: bool
    strange_unit: str = ""
    stated: bool = False

    @property
    def rank(self) -> int:
        """Rank of the column: the lower, the more it is the measured signal of a joint."""
        return (
            8 * self.external
            + 8 * self.compensated
            + 4 * self.commanded
            + 3 * self.motor
            + 2 * self.link
            - self.measured
            - 16 * self.stated
        )


def read_names(
    names: Sequence[str],
    units: Mapping[str, str],
    joint_names: Sequence[str] = (),
    stated: Mapping[str, str] = MappingProxyType({}),
) -> list[ColumnName]:
    """Read the names of all columns.

    Parameters
    ----------
    names : sequence of str
        Names of the columns, as the file has them.
    units : mapping of str to str
        Units by name that the file states elsewhere.
    joint_names : sequence of str
        Names of the robot's joints, whose words say nothing of the signal: axis_d is no desired value.
    stated : mapping of str to str
        What the user says that columns are, as our name of each. Only their units are read from their own names.

    Returns
    -------
    list of ColumnName
        What each name says, in the order of the columns.
    """
    # Abbreviations count only where all of a logger's names are there: alone they may mean anything.
    heads = {name.rstrip("0123456789") for name in names}
    meant = {word: text for needed, words in _LOGGERS if needed <= heads for word, text in words.items()}
    columns = []
    spellings = [spelling for own in list_spellings_by_joint(joint_names) for spelling in own]
    spellings += [(letter,) for letter in _find_letters_of_axes(names)]
    for name in names:
        head = name.rstrip("0123456789")
        plain = f"{meant[head]} {name[len(head) :]}" if head in meant else name
        column = read_name(plain, units.get(name, ""), spellings)
        if name in stated:
            column = replace(read_name(stated[name], column.unit or "", spellings), stated=True)
        columns.append(replace(column, name=name))
    columns = _tell_apart_by_unit(columns)
    others = {column.name for column in (*find_waves(columns), *_find_pose(columns, spellings))}
    # One time is enough: beside it t1, t2, … are counted as joints are, and may be torques.
    is_timed = any(column.signal == "t" and not column.numbers for column in columns)
    counted = {c.name for c in columns if is_timed and c.numbers and {w for w in c.words if not w.isdecimal()} == {"t"}}
    return [
        replace(column, signal="other" if column.name in others else None)
        if column.name in others or column.name in counted
        else column
        for column in columns
    ]


def _tell_apart_by_unit(columns: Sequence[ColumnName]) -> list[ColumnName]:
    """Return the columns, with the signal as a further word of those whose names differ by their units alone: j1_Nm."""
    of_units = [get_signal_of_unit(column.unit) or _SIGNALS_OF_SLIDING.get(column.unit or "") for column in columns]
    signals: dict[tuple[str, ...], set[Signal | None]] = {}
    for column, signal in zip(columns, of_units, strict=True):
        signals.setdefault(column.words, set()).add(signal)
    return [
        replace(column, words=(*column.words, signal), signal=signal)
        if column.signal is None and signal is not None and len(signals[column.words]) > 1
        else column
        for column, signal in zip(columns, of_units, strict=True)
    ]


def _find_letters_of_axes(names: Sequence[str]) -> tuple[str, ...]:
    """Return the letters of a pendant's axes, where names that end with all of them differ by nothing else."""
    letters: dict[str, set[str]] = {}
    for name in names:
        if len(name) > 2 and not name[-2].isalnum():
            letters.setdefault(name[:-1], set()).add(name[-1].casefold())
    axes = (tuple(words[0] for words in pendant) for pendant, _ in PENDANTS)
    return next((own for own in axes if set(own) in letters.values()), ())


def read_name(name: str, unit: str = "", spellings: Sequence[tuple[str, ...]] = ()) -> ColumnName:
    """Read a column's name; `unit` is what the file states elsewhere, `spellings` are the joints' names as words."""
    # Objects of drives and makers' words are put into plain ones before the name is taken apart.
    is_of_rated = any(match[0].casefold().strip("0xh") in _OF_RATED for match in _OBJECT.finditer(name))
    name = _OBJECT.sub(lambda match: _OBJECTS[match[0].casefold().strip("0xh")], name)
    for word, meaning in _MAKER_WORDS.items():
        name = name.replace(word, meaning)
    # Letters without their accents: posición is posicion.
    name = "".join(unicodedata.normalize("NFD", letter)[0] for letter in name)
    bracket = _BRACKET.search(name)
    inner = bracket.group(1) if bracket else ""
    stated = _UNITS.get(_normalise_unit(unit or inner))
    # A number in brackets is an index, {joint="elbow"} part of the name; anything else is a unit, a known one or not.
    is_named = bracket is None or ((stated is None or bool(unit)) and (inner.isdecimal() or "=" in inner))
    text = name if bracket is None or is_named else name[: bracket.start()]
    # The number of the joint may stand behind the unit: torque_cNm_1.
    behind = number.group() if (number := _NUMBER_BEHIND.search(text)) else ""
    ending = _ENDING.search(text) or _ENDING.search(text.removesuffix(behind))
    if stated is None and ending is not None:
        stated = _UNITS[_normalise_unit(ending.group(1))]
        text = text[: ending.start()] + (behind if ending.end() < len(text) else "")
    # Capitals separate words, as in jointPosition, so they are lowered only after the split.
    parts = _PART.findall(_UNSPACED.sub(r" \g<0> ", _SECOND_DOT.sub(" ddot ", text)))
    words = tuple(word.casefold() for word in parts)
    places = [(len(spelling), place) for spelling in spellings if (place := find_phrase(words, spelling)) is not None]
    length, place = max(places, default=(0, 0))
    # The last letter of a joint's name is no unit: axis_a is not in amperes. A unit may stand before it: trq_pct_B.
    behind_unit = words[place:] if length and place + length == len(words) else ()
    words, stated = _split_unit(words[: len(words) - len(behind_unit)], stated)
    words, place = (*words, *behind_unit), len(words) if behind_unit else place
    strange_unit = inner if stated is None and _STRANGE_UNIT.match(inner) else ""
    if stated is None and not unit and not strange_unit and is_of_rated:
        stated = "permille"
    everything = [word for word in words if not word.isdecimal()]
    plain = [word for word in (*words[:place], *words[place + length :]) if not word.isdecimal()]
    is_letter = bool(plain) and length == 1 == len(words[place])
    signal = _classify_signal(plain) or (None if is_letter else _classify_signal(everything))
    # The letter q also stands for an axis of a motor's field: what is in A is a current.
    if signal == "q" and stated in ("A", "mA"):
        signal = "current"
    # A joint may be called so, too; the end effector's place is counted, or along axes.
    if _END_EFFECTOR & set(words) and any(word.isdecimal() or word in _AXES for word in words):
        signal = "other"
    return ColumnName(
        name,
        signal,
        stated,
        words,
        tuple(int(word) for word in words if word.isdecimal()),
        commanded=any(word in _COMMANDED for word in plain),
        measured=any(word in _MEASURED for word in plain),
        external=any(word in _EXTERNAL for word in plain),
        compensated=any(word in _COMPENSATED for word in plain),
        motor=any(word in _MOTOR for word in plain),
        link="link" in plain and not any(word == "joint" for word in everything),
        strange_unit=strange_unit,
    )


_JOINT = frozenset({"joint", "jnt", "j", "axis", "achse", "a", "link"})
_EXTERNAL_AXIS = frozenset({"external", "ext", "e", "rail", "track"})
"""Words for an axis that carries a robot, in the place of or beside those for a joint."""


_JOINT_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def list_spellings(name: str) -> list[tuple[str, ...]]:
    """Return a joint's name as words, with and without the word joint; none that is a number alone."""
    words = tuple(word.casefold() for word in _JOINT_WORD.findall(name))
    bare = tuple(word for word in words if word != "joint")

    def is_name(spelling: tuple[str, ...]) -> bool:
        counted = any(word.isdecimal() for word in spelling)
        # Several general words without a number, such as axis_a, are a name all the same.
        return any(not word.isdecimal() and word not in _JOINT for word in spelling) or (
            len(spelling) > 1 and not counted
        )

    return [spelling for spelling in (words, bare) if is_name(spelling)]


def list_spellings_by_joint(names: Sequence[str]) -> list[list[tuple[str, ...]]]:
    """Return the joints' names as words; beside names proper, as a gripper's, joint1 is one as well."""
    spellings = [list_spellings(name) for name in names]
    if any(spellings):
        whole = [tuple(word.casefold() for word in _JOINT_WORD.findall(name)) for name in names]
        # Axes called z, a, b, c are single letters, some of which are general words beside a number.
        fewest = 2 - all(len(words) == len(words[0]) == 1 for words in whole if words)
        spellings = [own or [words] * (len(words) >= fewest) for own, words in zip(spellings, whole, strict=True)]
    return spellings


def strip_shared_words(names: Sequence[str]) -> tuple[str, ...]:
    """Return the joints' names without the words that all of them begin with: arm_sh0 and arm_el0 are sh_0 and el_0."""
    words = [_JOINT_WORD.findall(name) for name in names]
    alike = (len({tuple(own[: length + 1]) for own in words}) == 1 for length in range(min(map(len, words))))
    shared = len(list(takewhile(bool, alike))) if len(names) > 1 else 0
    return tuple("_".join(own[shared:]) for own in words)


def find_words_of_all(names: Sequence[str]) -> frozenset[str]:
    """Return the words that the names of all joints have, as that of the arm: right."""
    words = [frozenset(map(str.casefold, _JOINT_WORD.findall(name))) for name in names]
    return frozenset().union(*words).intersection(*words)


def find_phrase(words: tuple[str, ...], phrase: tuple[str, ...]) -> int | None:
    """Return the place in the words at which a phrase begins; None where it is not in them."""
    for start in range(len(words) - len(phrase) + 1):
        if words[start : start + len(phrase)] == phrase:
            return start
    return None


def _normalise_unit(unit: str) -> str:
    unit = unit.strip().casefold().replace("²", "^2").replace("**2", "^2").replace("-", "")
    if unit.startswith("%") and "/" not in unit:
        return "%"  # whatever it is a share of: % rated
    return unit if unit in _UNITS else re.sub(r"[ *·⋅._]", "", unit)


def _split_unit(words: tuple[str, ...], stated: str | None) -> tuple[tuple[str, ...], str | None]:
    """Split a unit off the end of the words: angle_1_deg."""
    if stated is None and len(words) >= 3 and words[-2:] in _PAIRS:
        return words[:-2], _PAIRS[words[-2:][0], words[-2:][1]]
    if stated is None and words[-2:] in (("nano", "sec"), ("nano", "secs")):
        return words[:-2], "ns"
    if stated is None and len(words) >= 2 and words[-1] in _SUFFIXES:
        # A single letter counts as a unit, too: i_1_a is in amperes. Of another signal it is an axis: pulse_s.
        signal = _classify_signal([word for word in words[:-1] if not word.isdecimal()])
        if len(words[-1]) > 1 or signal in (None, "effort", get_signal_of_unit(_UNITS[words[-1]])):
            return words[:-1], _UNITS[words[-1]]
    # The joint's number may stand behind it: PositionsRad_1.
    if stated is None and len(words) >= 3 and len(words[-2]) > 1 and words[-2] in _SUFFIXES and words[-1].isdecimal():
        return (*words[:-2], words[-1]), _UNITS[words[-2]]
    return words, stated


def _classify_signal(plain: list[str]) -> Signal | None:
    # Such words rule a joint's signal out, whatever else the name says.
    if any(word in _OTHER for word in plain):
        return "other"
    kind: Signal | None = None
    for word in plain:
        kind = "other" if word in _STATES else kind
        for signal, known in _WORDS.items():
            if word not in known or (word == "i" and len(plain) > 2):
                continue
            # The last word that names a kind decides: current_position is a position.
            if kind is None or len(word) > 1:
                kind = signal
    if kind in (rates := _SLIDING[:3]):
        # Derived as often as dots or letters d say: qDot, theta_ddot, ddQ. The d of qd_dot may stand for desired.
        letters = re.match(r"(d{1,2})(?:q|theta)", "".join(plain))
        order = plain.count("dot") + 2 * plain.count("ddot") - ("qd" in plain and "dot" in plain)
        return rates[min(max(rates.index(kind), len(letters[1]) if letters else 0) + order, 2)]
    if kind is None and "index" in plain:
        return "other"
    return kind


def count_external_axis(named: Sequence[ColumnName], kinds: Sequence[str]) -> list[ColumnName]:
    """Count the external axis of a controller with the joints of a robot that it carries, as the robot does.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    kinds : sequence of str
        What the robot's joints are, revolute or prismatic: the only one that slides is the axis.

    Returns
    -------
    list of ColumnName
        The columns; those of each signal that counts the other joints, and has one external axis, in the robot's order.
    """
    columns, joint = list(named), list(kinds).index("prismatic") if "prismatic" in kinds else -1
    if kinds.count("prismatic") != 1:
        return columns
    signals: dict[frozenset[str], list[int]] = {}
    for index, column in enumerate(named):
        if len(column.numbers) == 1 or _EXTERNAL_AXIS & set(column.words):
            words = frozenset(word for word in column.words if not word.isdecimal())
            core = words - _EXTERNAL_AXIS - _MEASURED - _JOINT - {"joints", "axes"}
            signals.setdefault(core, []).append(index)
    for members in signals.values():
        axes = [index for index in members if _EXTERNAL_AXIS & set(named[index].words)]
        others = sorted((index for index in members if index not in axes), key=lambda index: named[index].numbers)
        numbers = [named[index].numbers[0] for index in others]
        counts = [list(range(first, first + len(kinds) - 1)) for first in (0, 1)]
        if len(axes) != 1 or numbers not in counts:
            continue
        peer = named[others[0]]
        place = list(map(str.isdecimal, peer.words)).index(True)
        for number, index in enumerate([*others[:joint], axes[0], *others[joint:]]):
            counted = (*peer.words[:place], str(number), *peer.words[place + 1 :])
            columns[index] = replace(
                peer, name=named[index].name, unit=named[index].unit, words=counted, numbers=(number,)
            )
    return columns


def find_waves(named: Sequence[ColumnName]) -> list[ColumnName]:
    """Find the columns that have a partner of the same name but for sine and cosine: a sine alone names a motion."""
    present = {column.words for column in named}
    partners = [(column, tuple(_WAVES.get(word, word) for word in column.words)) for column in named]
    return [column for column, partner in partners if partner != column.words and partner in present]


_PLACE = ("x", "y", "z")
_TURNS = (("roll", "pitch", "yaw"), ("rx", "ry", "rz"), ("a", "b", "c"), ("qx", "qy", "qz"))
"""What a tool's position is called, and its orientation."""


def _find_pose(named: Sequence[ColumnName], spellings: Sequence[tuple[str, ...]]) -> list[ColumnName]:
    """Find the columns of a tool's pose, x, y, z, roll, pitch, yaw; none where the robot's joints are called so."""
    by_words = {column.words: column for column in named}
    pose: list[ColumnName] = []
    for turns in _TURNS:
        words = [(word,) for word in (*_PLACE, *turns)]
        if all(word in by_words for word in words) and not set(words) & set(spellings):
            pose += [by_words[word] for word in words]
    return pose
