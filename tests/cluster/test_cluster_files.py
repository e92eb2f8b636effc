"""The files for Slurm and Kubernetes."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def test_the_file_for_slurm_has_no_mistakes_of_the_shell() -> None:
    shellcheck = shutil.which("shellcheck", path=str(Path(sys.executable).parent)) or shutil.which(
        "shellcheck"
    )
    if shellcheck is None:
        pytest.skip("shellcheck is not installed")
    done = subprocess.run(
        [shellcheck, EXAMPLES / "slurm.sbatch"], capture_output=True, text=True, check=False
    )
    assert done.stdout == ""


def test_the_pods_of_the_manifest_are_valid() -> None:
    kubernetes = pytest.importorskip("kubernetes_validate")
    job = yaml.safe_load((EXAMPLES / "rayjob.yaml").read_text())["spec"]["rayClusterSpec"]
    for group in (job["headGroupSpec"], *job["workerGroupSpecs"]):
        pod = {"apiVersion": "v1", "kind": "Pod", "metadata": {"name": "pod"}, **group["template"]}
        kubernetes.validate(pod, kubernetes.latest_version(), strict=True)
