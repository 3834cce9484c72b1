"""The report of a real arm on paper."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from pypdf import PdfReader

from dynident.api.recording_files import read_recordings
from dynident.diagnosis import compare, diagnose
from dynident.identification import extend, identify
from dynident.reports import ReportedRecording, html_report, render_pdf
from dynident.robot import robot_from_urdf

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ur10e"
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.real_data,
    pytest.mark.skipif(
        not DATA.is_dir(), reason="the recordings of real robots are not here (../shared/data is missing)"
    ),
    pytest.mark.skipif(CHROMIUM is None, reason="printing needs Chromium"),
]


def test_the_report_of_six_joints_is_one_small_file_and_ten_numbered_pages_at_most(tmp_path):
    robot = robot_from_urdf("ur10e", (DATA / "robot.urdf").read_text(encoding="utf-8"))
    training, validation = (
        read_recordings(DATA / f"{name}.parquet", robot=robot, drive_gains=GAINS)[0]
        for name in ("id_30s_12harm", "val_ptp10")
    )
    plain = identify(robot, [training.recording], [validation.recording])
    found = diagnose(plain, [training.recording])
    grown = extend(plain, found.recommended, [training.recording], [validation.recording])
    runs = [
        ReportedRecording(one.recording, compare(grown, one.recording), held_out, one.checks)
        for one, held_out in ((training, False), (validation, True))
    ]
    page, paper = tmp_path / "report.html", tmp_path / "report.pdf"
    page.write_text(html_report(grown, runs, diagnosis=found), encoding="utf-8")
    assert page.stat().st_size <= 1_500_000
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--user-data-dir={tmp_path}")
    subprocess.run([CHROMIUM, *flags, f"--print-to-pdf={paper}", page.as_uri()], check=True, timeout=120)
    pages = re.findall(rb"/Type\s*/Page\b", paper.read_bytes())
    assert 5 <= len(pages) <= 10
    without_browser = PdfReader(io.BytesIO(render_pdf(page.read_text(encoding="utf-8")))).pages
    assert 5 <= len(without_browser) <= 10
    first = without_browser[0].extract_text()
    assert "Fit for" in first
    assert f"1 / {len(without_browser)}" in first
