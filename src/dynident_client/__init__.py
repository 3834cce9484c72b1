"""Python client of the dynident HTTP service: light enough for a robot's controller.

>>> from dynident_client import Client
>>> client = Client("http://127.0.0.1:8000")
>>> robot = client.robots.create("arm", urdf=Path("arm.urdf"))
>>> runs = [client.measurements.upload(robot, path) for path in ("run1.parquet", "run2.parquet")]
>>> model = client.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
>>> diagnosis = client.diagnoses.create(model).wait()
>>> better = client.identifications.extend(model, diagnosis.result["recommended"]).wait()
>>> client.reports.create(better, diagnosis=diagnosis).wait().save("report.html")
"""

from dynident_client.client import Client
from dynident_client.resource_objects import Computed, Job, Measurement, Page, Record, Report
from dynident_client.transport import JobCancelled, JobFailed, ProblemError

__all__ = [
    "Client",
    "Computed",
    "Job",
    "JobCancelled",
    "JobFailed",
    "Measurement",
    "Page",
    "ProblemError",
    "Record",
    "Report",
]
