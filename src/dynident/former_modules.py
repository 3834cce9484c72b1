"""Former paths and names of modules, which can be imported for one more release, with a warning.

Packages with effects, estimators or fields of their own import such paths. Delete this module, and what installs it in
`dynident/__init__.py`, with the next release.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

MODULES = {
    "dynident.advice.result": "dynident.advice.experiments",
    "dynident.api.own_effects": "dynident.api.effect_arguments",
    "dynident.api.robot_changes": "dynident.api.changes_over_time",
    "dynident.arrays": "dynident.array_types",
    "dynident.asking": "dynident.schema.fields",
    "dynident.descriptions": "dynident.robot.format_names",
    "dynident.desk": "dynident.api",
    "dynident.desk.changing": "dynident.api.changes_over_time",
    "dynident.desk.choosing": "dynident.api.effect_arguments",
    "dynident.desk.comparing": "dynident.api.comparison",
    "dynident.desk.designing": "dynident.api.motion_design",
    "dynident.desk.diagnosing": "dynident.api.model_diagnosis",
    "dynident.desk.figure": "dynident.api.figure",
    "dynident.desk.following": "dynident.api.changes_over_time",
    "dynident.desk.frames": "dynident.api.data_frames",
    "dynident.desk.identifying": "dynident.api.model_identification",
    "dynident.desk.inspecting": "dynident.api.recording_files",
    "dynident.desk.model": "dynident.api.model",
    "dynident.desk.parameters": "dynident.api.parameter_tables",
    "dynident.desk.reading": "dynident.api.recording_files",
    "dynident.desk.recordings": "dynident.api.recordings",
    "dynident.desk.reporting": "dynident.api.reporting",
    "dynident.desk.robots": "dynident.api.robot_files",
    "dynident.desk.texts": "dynident.text_and_html_tables",
    "dynident.desk.validating": "dynident.api.model_validation",
    "dynident.desk.xacro_files": "dynident.api.robot_files",
    "dynident.diagnosis.candidates.blocks": "dynident.diagnosis.candidates.joint_products",
    "dynident.diagnosis.comparing.autocorrelation": "dynident.diagnosis.comparing.autocorrelation_and_spectra",
    "dynident.diagnosis.comparing.spectrum": "dynident.diagnosis.comparing.autocorrelation_and_spectra",
    "dynident.effects.drive": "dynident.effects.motors",
    "dynident.effects.friction_in_time": "dynident.effects.friction",
    "dynident.effects.geometry": "dynident.effects.structure",
    "dynident.effects.hysteresis_operators": "dynident.effects.signals",
    "dynident.effects.linked": "dynident.effects.closed_loops",
    "dynident.effects.memory": "dynident.effects.hysteresis_states",
    "dynident.effects.operators": "dynident.effects.signals",
    "dynident.effects.plugins": "dynident.effects.catalogue",
    "dynident.effects.sizes": "dynident.effects.usual_sizes",
    "dynident.effects.written": "dynident.effects.text_format",
    "dynident.encoding": "dynident.text_encoding",
    "dynident.estimation.beside": "dynident.estimation.row_groups",
    "dynident.estimation.bootstrap": "dynident.estimation.block_bootstrap",
    "dynident.estimation.clusters": "dynident.estimation.uncertainty",
    "dynident.estimation.correlation": "dynident.estimation.residual_correlation",
    "dynident.estimation.dependence": "dynident.estimation.parameter_correlation",
    "dynident.estimation.deviations": "dynident.estimation.uncertainty",
    "dynident.estimation.essential": "dynident.estimation.backward_elimination",
    "dynident.estimation.information": "dynident.estimation.prior_information",
    "dynident.estimation.instrumental": "dynident.estimation.instrumental_variables",
    "dynident.estimation.kalman": "dynident.estimation.kalman_filter",
    "dynident.estimation.linearised": "dynident.estimation.shape_constant_uncertainty",
    "dynident.estimation.marginalisation": "dynident.identification.equations.model_equations",
    "dynident.estimation.nuisance": "dynident.identification.equations.model_equations",
    "dynident.estimation.recursive": "dynident.estimation.kalman_filter",
    "dynident.estimation.reversal_weights": "dynident.estimation.row_weights",
    "dynident.estimation.robust": "dynident.estimation.row_weights",
    "dynident.estimation.robust_weights": "dynident.estimation.row_weights",
    "dynident.estimation.semidefinite": "dynident.estimation.constrained_least_squares",
    "dynident.estimation.triangles": "dynident.estimation.qr",
    "dynident.estimation.turned": "dynident.estimation.row_groups",
    "dynident.estimation.turning_noise": "dynident.estimation.row_weights",
    "dynident.estimation.whitening": "dynident.estimation.qr",
    "dynident.excitation.formats": "dynident.excitation.design_files",
    "dynident.excitation.formats.design_files": "dynident.excitation.design_files",
    "dynident.excitation.formats.ros2": "dynident.excitation.design_files",
    "dynident.excitation.observation": "dynident.excitation.design_model",
    "dynident.excitation.observation.design_model": "dynident.excitation.design_model",
    "dynident.excitation.observation.row_model_names": "dynident.excitation.row_model_names",
    "dynident.excitation.observation.row_models": "dynident.excitation.row_models",
    "dynident.excitation.optimising.budget": "dynident.excitation.optimising.design_problem",
    "dynident.excitation.points": "dynident.excitation.point_sequence",
    "dynident.excitation.points.point_sequence": "dynident.excitation.point_sequence",
    "dynident.excitation.rehearsal": "dynident.excitation.design",
    "dynident.excitation.request_checks": "dynident.excitation.design",
    "dynident.export.exported_file": "dynident.export.projected_model",
    "dynident.expressions.machine_code": "dynident.expressions.program",
    "dynident.expressions.recurrence": "dynident.expressions.program",
    "dynident.identification.column_inference.robot_check": "dynident.identification.column_inference.dynamics_fits",
    "dynident.identification.entropic_prior": "dynident.identification.description_prior",
    "dynident.identification.fit": "dynident.identification.problem",
    "dynident.identification.loads.current_units": "dynident.identification.loads.current_models",
    "dynident.identification.methods.estimators.auto": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.didim": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.ekf": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.feasible": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.irls": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.iv": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.least_squares": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.ols": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.simulation": "dynident.identification.methods.estimators",
    "dynident.identification.methods.estimators.wls": "dynident.identification.methods.estimators",
    "dynident.identification.methods.models": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.base_wrench": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.dynamic": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.energy": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.equation_types": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.filtered": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.models.power": "dynident.identification.methods.equation_types",
    "dynident.identification.methods.priors": "dynident.identification.methods.description_priors",
    "dynident.identification.methods.priors.description": "dynident.identification.methods.description_priors",
    "dynident.identification.methods.priors.description_entropic": "dynident.identification.methods.description_priors",
    "dynident.identification.methods.strategies": "dynident.identification.methods.solution_order",
    "dynident.identification.methods.strategies.global_": "dynident.identification.methods.solution_order",
    "dynident.identification.methods.strategies.separate_friction": "dynident.identification.methods.solution_order",
    "dynident.identification.methods.strategies.sequential": "dynident.identification.methods.solution_order",
    "dynident.identification.methods.strategies.solution_order": "dynident.identification.methods.solution_order",
    "dynident.identification.parameters": "dynident.identification.standard_parameters",
    "dynident.identification.parameters.standard_parameters": "dynident.identification.standard_parameters",
    "dynident.identification.prior": "dynident.identification.description_prior",
    "dynident.identification.prior.description_prior": "dynident.identification.description_prior",
    "dynident.identification.prior.entropic": "dynident.identification.description_prior",
    "dynident.identification.shapes": "dynident.identification.shape_constants",
    "dynident.identification.shapes.shape_columns": "dynident.identification.shape_refinement",
    "dynident.identification.shapes.shape_constants": "dynident.identification.shape_constants",
    "dynident.identification.shapes.shape_refinement": "dynident.identification.shape_refinement",
    "dynident.identification.shapes.shape_search": "dynident.identification.shape_search",
    "dynident.identification.study.dependence": "dynident.identification.study.correlated_and_essential_parameters",
    "dynident.identification.study.estimate": "dynident.identification.study.result",
    "dynident.identification.study.reduced_data": "dynident.identification.equations.reduce_data",
    "dynident.identification.study.removing": "dynident.identification.study.solve_again",
    "dynident.identification.study.rigid_body_terms": "dynident.identification.study.prediction",
    "dynident.identification.study.same_recordings": "dynident.identification.study.identifying",
    "dynident.identification.study.slow_motion": "dynident.identification.study.identifying",
    "dynident.kinds": "dynident.schema.registry",
    "dynident.motion.moves": "dynident.motion.move_paths",
    "dynident.motion.moves.home": "dynident.motion.move_paths",
    "dynident.motion.moves.jerk_limited": "dynident.motion.jerk_limited_moves",
    "dynident.motion.moves.paths": "dynident.motion.move_paths",
    "dynident.motion.trajectories": "dynident.motion.joint_trajectories",
    "dynident.motion.trajectories.b_spline": "dynident.motion.joint_trajectories",
    "dynident.motion.trajectories.fourier": "dynident.motion.joint_trajectories",
    "dynident.motion.trajectories.motion": "dynident.motion.joint_trajectories",
    "dynident.motion.trajectories.periodic": "dynident.motion.joint_trajectories",
    "dynident.recordings.conditioning.signals": "dynident.recordings.conditioning.windows_and_changed_rows",
    "dynident.recordings.formats.messages": "dynident.recordings.formats.bags",
    "dynident.regressors.base_wrench": "dynident.regressors.equation_forms",
    "dynident.regressors.equations": "dynident.regressors.equation_rows",
    "dynident.regressors.extension": "dynident.regressors.model",
    "dynident.regressors.folding": "dynident.regressors.qr_accumulation",
    "dynident.regressors.forms": "dynident.regressors.equation_forms",
    "dynident.regressors.further_signals": "dynident.regressors.observation_matrix",
    "dynident.regressors.joined_programs": "dynident.regressors.observation_matrix",
    "dynident.regressors.observation": "dynident.regressors.observation_matrix",
    "dynident.regressors.rows": "dynident.regressors.row_cache",
    "dynident.regressors.stages": "dynident.regressors.equation_rows",
    "dynident.regressors.stream": "dynident.regressors.filtered_rows",
    "dynident.robot.dyads": "dynident.robot.passive_positions",
    "dynident.robot.joint_names": "dynident.robot.joint",
    "dynident.robot.mesh_files": "dynident.robot.meshes",
    "dynident.robot.mjcf_equality": "dynident.robot.mjcf",
    "dynident.robot.rounding": "dynident.robot.pinocchio_model",
    "dynident.side_by_side": "dynident.parallel",
    "dynident.testing.trial": "dynident.testing.trial_arm",
    "dynident.threads": "dynident.blas_threads",
    "dynident.validation.drift": "dynident.validation.simulation",
    "dynident.validation.method": "dynident.validation.request",
    "dynident.validation.noise": "dynident.validation.filter_choice",
    "dynident.verdict.use": "dynident.verdict.use_findings",
}
"""The present module of each former one."""

NAMES: dict[str, dict[str, str]] = {
    "dynident.api.data_frames": {
        "columns_of": "build_columns",
    },
    "dynident.api.effect_arguments": {
        "Diagnosed": "HasDiagnosis",
        "added_effects": "collect_added_effects",
        "checked_effects": "check_effects",
        "named_effects": "resolve_effects",
    },
    "dynident.api.figure": {
        "check_folder": "check_folder_exists",
        "figure_of": "join_figures",
    },
    "dynident.api.model": {
        "NO_DATA": "NO_RECORDINGS",
    },
    "dynident.api.model_diagnosis": {
        "check_some": "check_not_empty",
    },
    "dynident.api.recordings": {
        "Source": "RecordingSource",
    },
    "dynident.api.robot_files": {
        "expanded": "expand_xacro",
        "with_gains": "set_drive_gains",
    },
    "dynident.effects.closed_loops": {
        "LinkedMechanics": "DependentMechanics",
        "all_positions": "build_all_positions",
        "torque_of_links": "build_link_torque",
    },
    "dynident.effects.hysteresis_states": {
        "step": "step_state",
        "step_expression": "build_step_expression",
    },
    "dynident.effects.text_format": {
        "constant_in_words": "format_constant",
        "effect_parts": "parse_effect",
        "effect_text": "format_effect",
        "effect_texts": "split_effects",
        "written_effects": "parse_effects",
    },
    "dynident.effects.usual_sizes": {
        "Usual": "UsualSize",
        "largest_torque": "get_largest_torque",
        "slowest_velocity": "get_slowest_velocity",
        "usual_coulomb": "get_usual_coulomb",
        "usual_force": "get_usual_force",
        "usual_viscous": "get_usual_viscous",
        "velocity_scale": "get_velocity_scale",
    },
    "dynident.estimation.backward_elimination": {
        "LEVEL": "ELIMINATION_LEVEL",
        "RATIO": "WELL_IDENTIFIED_RATIO",
        "eliminate": "eliminate_parameters",
    },
    "dynident.estimation.block_bootstrap": {
        "MANY": "FEWEST_BLOCKS_FOR_PAIRS",
        "bootstrap": "bootstrap_estimates",
    },
    "dynident.estimation.parameter_correlation": {
        "CLOSE": "STRONG_CORRELATION",
        "CloseTogether": "CorrelatedPair",
        "Dependence": "Collinearity",
        "HARDLY": "POORLY_DETERMINED",
        "HardlySeen": "WeakDirection",
        "NEVER": "NOT_DETERMINED",
        "dependence": "find_collinearity",
    },
    "dynident.estimation.constrained_least_squares": {
        "Constrained": "ConstrainedSolution",
        "Equations": "EqualityConstraints",
        "constrained_least_squares": "solve_constrained",
    },
    "dynident.estimation.shape_constant_uncertainty": {
        "Linearised": "LinearisedSolution",
        "linearised": "linearise_constants",
    },
    "dynident.estimation.instrumental_variables": {
        "instrumental": "solve_instrumental",
    },
    "dynident.estimation.kalman_filter": {
        "recursive_statistics": "compute_recursive_statistics",
    },
    "dynident.identification.equations.model_equations": {
        "without_nuisance": "marginalise_parameters",
    },
    "dynident.estimation.prior_information": {
        "Information": "PriorInformation",
        "covariance_of": "invert_information",
        "deviations_of": "extract_deviations",
        "known_values": "build_prior",
        "root_of": "invert_factor",
    },
    "dynident.estimation.qr": {
        "Whitened": "WhitenedColumns",
        "join": "join_factors",
        "squared": "pad_to_square",
        "triangular": "compute_r_factor",
        "whitened": "whiten_columns",
    },
    "dynident.estimation.residual_correlation": {
        "correlation_factor": "compute_correlation_factor",
        "correlation_factors": "compute_correlation_factors",
        "effective_rows": "count_effective_rows",
        "overstatement": "compute_overstatement",
    },
    "dynident.estimation.row_groups": {
        "Apart": "RowGroup",
        "Beside": "SeparateRows",
        "BesideAccumulator": "IntervalRowAccumulator",
        "MOST": "MOST_INTERVAL_ROWS",
        "Turned": "WeightedRows",
        "beside_all": "join_separate_rows",
        "distance_to_band": "compute_band_distance",
    },
    "dynident.estimation.row_weights": {
        "robust_scale": "estimate_robust_scale",
        "turning_weights": "estimate_group_weights",
    },
    "dynident.estimation.uncertainty": {
        "Spread": "ClusterCovariance",
        "correlations": "compute_correlations",
        "deviations": "compute_standard_deviations",
        "freedom_of_rows": "compute_row_freedom",
        "null_space": "compute_null_space",
        "occupied": "find_occupied_blocks",
        "owed_to_known": "find_prior_dominated",
        "spread_over_stretches": "estimate_cluster_covariance",
        "without_leverage": "remove_leverage",
    },
    "dynident.parallel": {
        "Parts": "WorkQueue",
        "WORTH": "MIN_PARALLEL_SIZE",
        "ahead": "prefetch",
        "one_by_one": "map_sequentially",
        "processors": "count_processors",
        "side_by_side": "map_in_threads",
    },
    "dynident.regressors.equation_forms": {
        "Form": "EquationForm",
        "filtered_form": "build_filtered_form",
        "power_form": "build_power_form",
        "wrench_form": "build_wrench_form",
    },
    "dynident.regressors.equations": {
        "differences": "take_differences",
        "integrated": "integrate_samples",
        "rated": "differentiate_samples",
        "smoothed": "smooth_samples",
    },
    "dynident.regressors.filtered_rows": {
        "AtRest": "RestRowBuilder",
        "filtered_samples": "stream_filtered_samples",
        "in_run": "is_in_run",
        "low_passed": "low_pass_samples",
        "parallel_filtered": "filter_in_parallel",
        "sampled": "stream_samples",
    },
    "dynident.regressors.model": {
        "extended_model": "extend_model",
    },
    "dynident.regressors.observation": {
        "JoinedPrograms": "ConcatenatedPrograms",
    },
    "dynident.regressors.qr_accumulation": {
        "BesideRows": "RestRows",
        "Folding": "EquationAccumulator",
        "folded": "accumulate_equations",
        "stretch_length": "choose_block_length",
        "used_duration": "compute_used_duration",
    },
    "dynident.regressors.row_cache": {
        "KeptRows": "CachedRows",
        "reduce_and_keep": "reduce_and_cache",
        "reduce_with_more": "reduce_with_columns",
    },
    "dynident.text_and_html_tables": {
        "block": "join_html",
        "folded": "render_details",
        "listed": "render_list",
        "paragraph": "render_paragraph",
        "table": "render_table",
        "text_table": "format_text_table",
    },
    "dynident.schema.fields": {
        "About": "FieldOptions",
        "Named": "NamedValues",
        "Said": "FieldDescription",
        "anew": "redeclare_field",
        "default_of": "get_default",
        "retold": "redescribe_field",
        "said": "declare_field",
        "said_of": "get_description",
    },
    "dynident.schema.registry": {
        "Kind": "RegistryEntry",
        "KindT": "EntryT",
        "Kinds": "Registry",
        "document_of": "kind_to_document",
        "name_of": "get_kind_name",
        "words_of": "format_kind",
    },
}
"""The present name of each former name in a present module."""

_PACKAGES = {module.rpartition(".")[0] for module in MODULES} & MODULES.keys()
"""Former modules that were packages of other former modules."""


class FormerModuleFinder(MetaPathFinder, Loader):
    """Finds modules by their former paths; each gives what its present module has, by former and by present names."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a spec if the module is a former one."""
        return ModuleSpec(fullname, self, is_package=fullname in _PACKAGES) if fullname in MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        """Let the module look up its names in the present one."""
        present = MODULES[module.__name__]
        warnings.warn(
            f"{module.__name__} is now {present}; the next release removes the old path.",
            DeprecationWarning,
            stacklevel=2,
        )

        def get(name: str) -> object:
            # Python itself asks modules for names such as __path__; a present module's answer would be about that
            # module.
            if name.startswith("__"):
                raise AttributeError(name)
            return getattr(import_module(present), NAMES.get(present, {}).get(name, name))

        module.__dict__["__getattr__"] = get
