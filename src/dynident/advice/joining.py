"""A diagnosis and the advice on what to do next."""

from __future__ import annotations

from dataclasses import fields

from dynident.advice.next_experiment import next_experiment
from dynident.advice.result import AdvisedDiagnosis
from dynident.diagnosis import Diagnosis, Examination
from dynident.threads import single_threaded


@single_threaded
def advise(examined: Examination) -> AdvisedDiagnosis:
    """Propose the experiment that would decide what a diagnosis leaves open.

    Parameters
    ----------
    examined : Examination
        What `dynident.diagnosis.examine` returned: the diagnosis, its doubts, and the data behind it.

    Returns
    -------
    AdvisedDiagnosis
        The diagnosis with the proposed experiment; `next_experiment` is None where no motion decides anything.
    """
    proposed = next_experiment(examined.identification, examined.comparisons, examined.doubts, examined.recordings)
    diagnosis_fields = {field.name: getattr(examined.diagnosis, field.name) for field in fields(Diagnosis)}
    return AdvisedDiagnosis(**diagnosis_fields, next_experiment=proposed)
