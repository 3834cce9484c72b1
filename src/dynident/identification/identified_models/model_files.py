"""Write and read the file of a model in the present format."""

from __future__ import annotations

import copyreg
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import EffectChoice, ReferenceParameters, Signals
from dynident.effects.predicted_torque_expressions import CarriedInertia
from dynident.errors import DynidentError
from dynident.estimation import (
    BlockRows,
    EquationFactors,
    Errors,
    IntervalRows,
    PriorInformation,
    Reduction,
    RowGroup,
    SeparateRows,
    Solution,
    Statistics,
    WeightedRows,
    compute_row_freedom,
)
from dynident.identification.equations.reduced_recordings import ReducedData
from dynident.identification.identification_choices import USUAL_SHARE, IdentificationChoices
from dynident.identification.identified_models.former_model_files import (
    NAME,
    PRESENT,
    check_determined_base,
    other_parameters_error,
    read_ladder,
)
from dynident.identification.identified_models.identification_result import Estimate, Identification, LadderStep
from dynident.identification.methods.base_classes import ESTIMATORS
from dynident.identification.shape_constant_intervals import ShapeConstant, judge_shape_constants
from dynident.identification.standard_parameters import (
    StandardParameters,
    compute_smallest_inertia_eigenvalue,
)
from dynident.recordings import Preprocessing
from dynident.regressors.base_parameters import BaseParameters
from dynident.regressors.model_structure import Model, build_model
from dynident.robot import Robot
from dynident.robot.description_and_json import robot_from_document, robot_to_document
from dynident.schema.registry import kind_to_document

_FORMERLY_KNOWN = (
    "The known {} was used as a standard parameter, as in earlier versions: this model keeps it, but models made from "
    "it do not. Identify again with the value of the whole sum."
)
_INTERVAL_FIELDS = ("upper", "lower", "y", "weights")


def to_bytes(identification: Identification) -> bytes:
    """Return the identification, with all its ancestors, as the bytes of an .npz file.

    Not compressed: the factors are all but a few of the bytes, and their digits do not shrink.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    bytes
        Content of the file, in the present format.
    """
    arrays: dict[str, Any] = {}
    # All models side by side: a file inside a file would be copied once a step.
    ladder = list(identification.ladder())
    for number, model in enumerate(ladder):
        arrays |= {f"{number}/{name}": array for name, array in _to_arrays(model).items()}
    arrays["header"] = _encode_json({"format": f"{NAME} {PRESENT}", "rungs": len(ladder)})
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _to_arrays(identification: Identification) -> dict[str, Any]:
    """Return the arrays of one model without its ancestors."""
    estimate, data, base = identification.estimate, identification.data, identification.model.base
    arrays: dict[str, Any] = {
        "reference": estimate.reference.vector,
        "values": estimate.solution.values,
        "solution_noise": estimate.solution.noise,
        "solution_factor": estimate.solution.factor,
        "covariance": estimate.statistics.covariance,
        "effective_rows": estimate.statistics.effective_rows,
        "noise": estimate.statistics.noise,
        "freedom": estimate.statistics.freedom,
        "base_kept": np.array(base.kept, dtype=np.int64),
        "base_grouping": base.grouping,
        "base_written": base.written,
        "base_without_effect": np.array(base.without_effect, dtype=np.int64),
    }
    for number, carried in enumerate(estimate.reference.carried):
        arrays[f"carried{number}"] = carried.inertias
    if estimate.solution.known is not None:
        arrays["known_rows"] = estimate.solution.known.rows
        if estimate.solution.known.held is not None:
            arrays["known_held"] = estimate.solution.known.held
    if estimate.solution.free is not None:
        arrays["free"] = estimate.solution.free
    if estimate.standard is not None:
        arrays["standard_values"] = estimate.standard.values
        arrays["standard_deviations"] = estimate.standard.standard_deviations
    _put_errors(arrays, "fit", identification.fit)
    _put_reduction(arrays, "training", data.training)
    # For the dynamic model both are one object, and are stored once.
    if not data.is_fitted_to_torque:
        _put_reduction(arrays, "equations", data.equations)
    if data.shaped is not None:
        _put_reduction(arrays, "shaped", data.shaped)
    if identification.held_out is not None and data.held_out is not None:
        _put_errors(arrays, "held_out", identification.held_out)
        _put_reduction(arrays, "held_out_data", data.held_out)
    arrays["header"] = _encode_json(
        {
            "robot": robot_to_document(identification.model.robot),
            "choices": _to_choices_document(identification.choices),
            "preprocessing": asdict(data.preprocessing),
            "base_names": base.names,
            "base_rank": base.rank,
            "condition_number": identification.condition_number,
            "worst_inertia_eigenvalue": identification.worst_inertia_eigenvalue,
            "warnings": identification.warnings,
            "measurement_names": data.measurement_names,
            "validation_names": data.validation_names,
            "copied": data.copied,
            "digests": data.digests,
            "from_commands": data.from_commands,
            "speeds": None if data.speeds is None else data.speeds.tolist(),
            "added": [asdict(choice) for choice in identification.step.added],
            "removed": [asdict(choice) for choice in identification.step.removed],
            "not_essential": estimate.not_essential,
            "carried": [carried.runs for carried in estimate.reference.carried],
            "converged": estimate.solution.converged,
            "known_sums": True,
            "shape_constants": [asdict(constant) for constant in estimate.shape_constants],
        }
    )
    return arrays


def _encode_json(document: Mapping[str, Any]) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(document).encode(), dtype=np.uint8)


def from_bytes(content: bytes) -> Identification:
    """Read the identification from bytes that `to_bytes` made.

    Parameters
    ----------
    content : bytes
        Content of a file, of any format that was ever written.

    Returns
    -------
    Identification
        The model, with the models that led to it.

    Raises
    ------
    DynidentError
        Where the bytes are something else.
    """
    try:
        return _read_identification(content)
    # These errors say already what is wrong with the model.
    except DynidentError:
        raise
    except Exception as error:  # what damaged bytes raise is no closed list: zip, zlib, numpy, json, missing keys
        raise DynidentError(
            "this is not a model file that this version can read; give a file that an identification wrote",
            title="Unreadable model",
        ) from error


# CasADi's expressions cannot be pickled by themselves: a model is pickled as its file.
copyreg.pickle(Identification, lambda identification: (from_bytes, (to_bytes(identification),)))


def _read_identification(content: bytes) -> Identification:
    identification: Identification | None = None
    for arrays in read_ladder(content):
        identification = _read_model(arrays, identification)
    if identification is None:
        raise ValueError("not a model")
    return identification


def _read_carried(arrays: Mapping[str, Any], header: Mapping[str, Any]) -> tuple[CarriedInertia, ...]:
    """Read what links carry in some runs; earlier files have nothing of it."""
    labels = header.get("carried", ())
    return tuple(CarriedInertia(tuple(runs), arrays[f"carried{number}"]) for number, runs in enumerate(labels))


def _read_model(arrays: Mapping[str, Any], parent: Identification | None) -> Identification:
    """Read one model on top of the one before it."""
    header = json.loads(arrays["header"].tobytes())
    stored = choices = _read_choices(header["choices"])
    base = _read_base(arrays, header)
    robot, signals = (robot_from_document(header["robot"]), None) if parent is None else _share_mechanics(parent)
    model = build_model(robot, choices.effects, tolerance=choices.tolerance, signals=signals, base=base)
    # Base parameters of the first format are determined anew, so they have to be compared with those of the file.
    if base is None:
        check_determined_base(model, arrays, compute_smallest_inertia_eigenvalue(model, arrays["values"]))
    elif tuple(column.name for column in model.columns) != base.names:
        raise other_parameters_error()
    # Earlier versions knew standard parameters, of which a base parameter may be a sum.
    if "known_held" not in arrays and not header.get("known_sums", False):
        alone = [row.sum() == 1 for row in model.base.written]
        choices = stored.keep_known(
            [column.name for column, is_alone in zip(model.kept, alone, strict=True) if is_alone]
        )
    lost = tuple(_FORMERLY_KNOWN.format(name) for name in stored.known if name not in choices.known)
    data = _read_data(arrays, header)
    estimate = Estimate.from_solution(
        model,
        data,
        replace(ReferenceParameters.from_vector(arrays["reference"], robot), carried=_read_carried(arrays, header)),
        _read_solution(arrays, bool(header.get("converged", True))),
        _read_statistics(arrays),
        standard=_read_standard(arrays),
        not_essential=tuple(header.get("not_essential", ())),
        shape_constants=_read_shape_constants(header, model),
    )
    return Identification(
        estimate=estimate.with_robust_noise() if choices.solver.robust else estimate,
        choices=choices,
        data=data,
        fit=_read_errors(arrays, "fit"),
        held_out=_read_errors(arrays, "held_out") if "held_out_squares" in arrays else None,
        worst_inertia_eigenvalue=float(header["worst_inertia_eigenvalue"]),
        warnings=(*lost, *header["warnings"]),
        step=_read_step(header, parent),
    )


def _read_base(arrays: Mapping[str, Any], header: Mapping[str, Any]) -> BaseParameters | None:
    """Read the base parameters that were stored; None where they are to be determined."""
    if "base_kept" not in arrays:  # the first format
        return None
    return BaseParameters(
        names=tuple(header["base_names"]),
        kept=tuple(arrays["base_kept"].tolist()),
        grouping=arrays["base_grouping"],
        written=arrays["base_written"],
        without_effect=tuple(arrays["base_without_effect"].tolist()),
        rank=int(header["base_rank"]),
    )


def _read_data(arrays: Mapping[str, Any], header: Mapping[str, Any]) -> ReducedData:
    others = ("equations", "held_out_data", "shaped")
    equations, held_out, shaped = (
        _read_reduction(arrays, name) if f"{name}_size" in arrays else None for name in others
    )
    # Where no equations are stored they are the torques, and have to be the same object: others test for identity.
    training = _read_reduction(arrays, "training")
    return ReducedData(
        equations=training if equations is None else equations,
        training=training,
        held_out=held_out,
        shaped=shaped,
        preprocessing=_read_preprocessing(header["preprocessing"]),
        measurement_names=tuple(header["measurement_names"]),
        validation_names=tuple(header["validation_names"]),
        copied=tuple(header.get("copied", ())),
        digests=tuple(header.get("digests", ())),
        from_commands=bool(header.get("from_commands", False)),
        speeds=None if header.get("speeds") is None else np.array(header["speeds"]),
    )


def _read_step(header: Mapping[str, Any], parent: Identification | None) -> LadderStep:
    added, removed = (tuple(_read_effect(item) for item in header[name]) for name in ("added", "removed"))
    return LadderStep(parent, added, removed)


def _read_solution(arrays: Mapping[str, Any], converged: bool) -> Solution:
    known = None
    if "known_rows" in arrays:
        rows = arrays["known_rows"]
        known = PriorInformation(rows[:, :-1], rows[:, -1], arrays.get("known_held"))
    free = arrays.get("free")
    return Solution(arrays["values"], arrays["solution_noise"], arrays["solution_factor"], known, free, converged)


def _read_statistics(arrays: Mapping[str, Any]) -> Statistics:
    covariance, worth = arrays["covariance"], arrays["effective_rows"]
    # Files of older versions have no degrees of freedom; they follow from the rows.
    freedom = arrays.get("freedom", compute_row_freedom(worth, len(covariance)))
    return Statistics(covariance, worth, arrays["noise"], freedom)


def _read_standard(arrays: Mapping[str, Any]) -> StandardParameters | None:
    if "standard_values" not in arrays:
        return None
    return StandardParameters(arrays["standard_values"], arrays["standard_deviations"])


def _read_shape_constants(header: Mapping[str, Any], model: Model) -> tuple[ShapeConstant, ...]:
    if "shape_constants" not in header:
        return judge_shape_constants(model, None)
    return tuple(_read_shape_constant(document) for document in header["shape_constants"])


def _read_shape_constant(document: Mapping[str, Any]) -> ShapeConstant:
    ends = document["interval"]
    interval = None if ends is None else (float(ends[0]), float(ends[1]))
    # JSON has no tuples, and equal constants have to compare equal.
    return ShapeConstant(**{**document, "joints": tuple(document["joints"]), "interval": interval})


def _share_mechanics(parent: Identification) -> tuple[Robot, Signals]:
    # A ladder is one of one robot: its mechanics are derived once.
    return parent.model.robot, parent.model.signals


def _read_effect(document: Mapping[str, Any]) -> EffectChoice:
    shape = tuple((str(name), float(value)) for name, value in document["shape"])
    return EffectChoice(document["effect"], tuple(document["joints"]), shape, tuple(document.get("runs", ())))


def _to_choices_document(choices: IdentificationChoices) -> dict[str, Any]:
    return {**asdict(choices), "estimator": kind_to_document(choices.estimator)}


def _read_choices(document: Mapping[str, Any]) -> IdentificationChoices:
    return IdentificationChoices(
        effects=tuple(_read_effect(item) for item in document["effects"]),
        model=document["model"],
        strategy=document["strategy"],
        estimator=ESTIMATORS.from_document(document["estimator"]),
        steps=document.get("steps", "link_by_link"),
        prior=document.get("prior"),
        free_links=tuple(document.get("free_links", ())),
        prior_error=document.get("prior_error", USUAL_SHARE),
        known=document.get("known", {}),
        known_errors=document.get("known_errors", {}),
        pole=document.get("pole"),
        interval=document.get("interval"),
        preprocessing=_read_preprocessing(document["preprocessing"]) if document["preprocessing"] else None,
        tolerance=document["tolerance"],
        # What a file of an older version does not state, it was identified without.
        covariance=document.get("covariance", "by_joint"),
        weigh_turns=bool(document.get("weigh_turns", False)),
    )


def _read_preprocessing(document: Mapping[str, Any]) -> Preprocessing:
    return Preprocessing(**{**document, "reasons": tuple(document["reasons"])})


def _put_errors(arrays: dict[str, Any], name: str, errors: Errors) -> None:
    arrays[f"{name}_squares"] = errors.squares
    arrays[f"{name}_measured"] = errors.measured
    arrays[f"{name}_counts"] = errors.counts


def _read_errors(arrays: Mapping[str, Any], name: str) -> Errors:
    return Errors(arrays[f"{name}_squares"], arrays[f"{name}_measured"], arrays[f"{name}_counts"])


def _put_reduction(arrays: dict[str, Any], name: str, reduction: Reduction) -> None:
    arrays[f"{name}_spans"] = reduction.spans
    arrays[f"{name}_size"] = np.array([reduction.n_columns, len(reduction.equations)])
    for j, equation in enumerate(reduction.equations):
        arrays[f"{name}_{j}_columns"] = equation.columns
        # Only the rows apart from the reversals are stored; with the rows at reversals they give the whole factor
        # again.
        weighted = equation.weighted_rows
        factors = equation.factors if weighted is None else weighted.others
        arrays[f"{name}_{j}_factors"] = factors[:, *_locate_upper(*factors.shape[1:])]
        arrays[f"{name}_{j}_counts"] = equation.counts
        # The files name groups by what makes them: rows "turned" are those at reversals, those "beside" are at rest.
        if weighted is not None:
            parts = {"rows": weighted.rows, "counts": weighted.counts, "weight": np.array(weighted.weight)}
            arrays |= {f"{name}_{j}_turned_{part}": array for part, array in parts.items()}
        if equation.separate_rows is not None:
            _put_separate_rows(arrays, f"{name}_{j}_beside", equation.separate_rows)


def _put_separate_rows(arrays: dict[str, Any], name: str, rows: SeparateRows) -> None:
    if rows.fixed is not None:
        factor = rows.fixed.factor
        arrays[f"{name}_turning"] = factor[*np.triu_indices(len(factor))]
        arrays[f"{name}_n_turning"] = np.array(rows.fixed.count)
    arrays[f"{name}_starting_rows"] = rows.counted.rows
    arrays[f"{name}_starting_counts"] = rows.counted.counts
    for field in _INTERVAL_FIELDS:
        arrays[f"{name}_{field}"] = getattr(rows.interval, field)


def _read_separate_rows(arrays: Mapping[str, Any], name: str, size: int) -> SeparateRows | None:
    if f"{name}_starting_rows" in arrays:
        counted = BlockRows(arrays[f"{name}_starting_rows"], arrays[f"{name}_starting_counts"])
    elif f"{name}_partial" in arrays:  # of formats up to 3, which did not keep these rows by blocks of time
        partial = _read_factor(arrays, f"{name}_partial", f"{name}_n_partial", size)
        counted = BlockRows(partial.factor[None], np.array([partial.count]))
    else:
        return None
    fixed = None
    if f"{name}_turning" in arrays:  # of formats up to 3, in data that is not weighted
        fixed = _read_factor(arrays, f"{name}_turning", f"{name}_n_turning", size)
    return SeparateRows(fixed, counted, IntervalRows(*(arrays[f"{name}_{field}"] for field in _INTERVAL_FIELDS)))


def _read_factor(arrays: Mapping[str, Any], factor: str, count: str, size: int) -> RowGroup:
    return RowGroup(_unpack_triangles(arrays[factor][None], size)[0], int(arrays[count]))


def _read_reduction(arrays: Mapping[str, Any], name: str) -> Reduction:
    n_columns, n_equations = (int(value) for value in arrays[f"{name}_size"])
    equations = tuple(_read_equation(arrays, f"{name}_{j}") for j in range(n_equations))
    return Reduction(n_columns, equations, arrays[f"{name}_spans"])


def _read_equation(arrays: Mapping[str, Any], name: str) -> EquationFactors:
    columns, counts = arrays[f"{name}_columns"], arrays[f"{name}_counts"]
    size = len(columns) + 1
    factors, separate_rows = (
        _unpack_triangles(arrays[f"{name}_factors"], size),
        _read_separate_rows(arrays, f"{name}_beside", size),
    )
    if f"{name}_turned_rows" not in arrays:  # of a version that did not tell them apart
        return EquationFactors(columns, factors, counts, separate_rows)
    rows, own = arrays[f"{name}_turned_rows"], arrays[f"{name}_turned_counts"]
    weighted = WeightedRows(rows, own, factors, float(arrays[f"{name}_turned_weight"]))
    return EquationFactors.from_groups(columns, weighted, counts, separate_rows)


def _unpack_triangles(packed: FloatArray, size: int) -> FloatArray:
    """Unpack the first m rows of upper triangles (s, m, k) from their k + (k - 1) + … values each."""
    # Number of values in the first 0, 1, …, k rows: it tells how many rows there are.
    sizes = np.cumsum([0, *range(size, 0, -1)])
    rows = int(np.searchsorted(sizes, packed.shape[1]))
    factors = np.zeros((len(packed), rows, size))
    factors[:, *_locate_upper(rows, size)] = packed
    return factors


def _locate_upper(rows: int, size: int) -> tuple[IndexArray, IndexArray]:
    """Return the places on and above the diagonal of a matrix (rows, size)."""
    return np.triu_indices(rows, m=size)
