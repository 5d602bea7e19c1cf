"""A Python client made by openapi-python-client from the live contract, and used as its users would."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CONVERSATION = """
import sys
import time

from ricochet_client import Client
from ricochet_client.api.critical_ricochet_angle import (
    find_critical_angle, find_critical_angles, sweep_critical_angles,
)
from ricochet_client.api.health import livez, readyz, version
from ricochet_client.api.jobs import cancel_job, delete_job, get_job, get_job_results, list_jobs
from ricochet_client.api.results import get_result
from ricochet_client.api.trajectory import compute_trajectory
from ricochet_client.models import (
    Axis, CriticalAngleAnswer, CriticalAngleBatch, CriticalAngleCase, CriticalAngleRequest, CriticalAngleResults,
    CriticalAngleSweep, Impact, Job, JobResults, JobStatus, OgiveNose, Outcome, Problem, Projectile, SearchStatus,
    Strike, Target, TrajectoryAnswer, TrajectoryOutput, TrajectoryRequest,
)
from ricochet_client.types import UNSET

client = Client(base_url=sys.argv[1], raise_on_unexpected_status=True)
projectile = Projectile(
    nose=OgiveNose(shape="ogive", caliber_radius_head=3.0), diameter_m=0.08, length_m=0.53, mass_kg=13.0
)
target = Target(compressive_strength_pa=39e6, density_kg_m3=2250.0)

case = CriticalAngleRequest(projectile=projectile, target=target, impact=Strike(velocity_m_s=238.0))
found = find_critical_angle.sync(client=client, body=case)
assert isinstance(found, CriticalAngleAnswer)
assert found.status == SearchStatus.CONVERGED
assert abs(found.critical_angle_deg - 48.57) < 0.05, found.critical_angle_deg
assert found.iterations[0].outcome == Outcome.EMBEDDED
assert found.trajectory is UNSET
assert get_result.sync(client=client, key=found.key) == found
assert CriticalAngleRequest.from_dict(case.to_dict()) == case

for oblique_angle_deg, outcome in ((45.0, Outcome.EMBEDDED), (55.0, Outcome.RICOCHET)):
    impact = Impact(velocity_m_s=238.0, oblique_angle_deg=oblique_angle_deg)
    shot = TrajectoryRequest(projectile=projectile, target=target, impact=impact)
    answer = compute_trajectory.sync(client=client, body=shot)
    assert isinstance(answer, TrajectoryAnswer)
    assert answer.outcome == outcome
    assert answer.history.time_s[-1] == answer.final.time_s
    shot.output = TrajectoryOutput(history=False)
    assert compute_trajectory.sync(client=client, body=shot).history is UNSET
    assert get_result.sync(client=client, key=answer.key) == answer

named = CriticalAngleCase(projectile=projectile, target=target, impact=Strike(velocity_m_s=238.0), custom_id="paper")
batch = CriticalAngleBatch(cases=[named, named])
results = find_critical_angles.sync(client=client, body=batch)
assert isinstance(results, CriticalAngleResults)
assert [(item.index, item.custom_id) for item in results.results] == [(0, "paper"), (1, "paper")]
assert [item.result for item in results.results] == [found, found]
assert results.results[0].problem is UNSET

job = find_critical_angles.sync(client=client, body=batch, prefer="respond-async")
assert isinstance(job, Job)
while job.status in (JobStatus.ACCEPTED, JobStatus.RUNNING):
    time.sleep(0.1)
    job = get_job.sync(client=client, job_id=job.id)
assert (job.status, job.counts.total) == (JobStatus.SUCCESSFUL, 2)
page = get_job_results.sync(client=client, job_id=job.id, limit=1)
assert isinstance(page, JobResults)
assert page.results[0].result == found
rest = get_job_results.sync(client=client, job_id=job.id, cursor=page.next_)
assert [item.index for item in rest.results] == [1]
assert rest.next_ is UNSET
assert cancel_job.sync(client=client, job_id=job.id) == job
assert job.id in [each.id for each in list_jobs.sync(client=client).jobs]
assert delete_job.sync_detailed(client=client, job_id=job.id).status_code == 204
assert isinstance(get_job.sync(client=client, job_id=job.id), Problem)

axis = Axis(field="impact.velocity_m_s", start=230.0, stop=238.0, count=2)
swept = sweep_critical_angles.sync(client=client, body=CriticalAngleSweep(base=case, axes=[axis]))
assert isinstance(swept, CriticalAngleResults)
assert swept.results[1].result == found

projectile.length_m = 0.1
problem = find_critical_angle.sync(client=client, body=case)
assert isinstance(problem, Problem)
assert [error.pointer for error in problem.errors] == ["/projectile/length_m"]
assert isinstance(get_result.sync(client=client, key="0" * 64), Problem)
assert livez.sync(client=client).status == readyz.sync(client=client).status == "ok"
assert "numpy" in version.sync(client=client).libraries
print("done")
"""


@pytest.fixture(scope="module")
def generated(live_url: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a package `ricochet_client`; its formatter is the ruff beside the Python that runs the tests."""
    folder = tmp_path_factory.mktemp("generated")
    scripts = Path(sys.executable).parent
    command = [str(scripts / "openapi-python-client"), "generate", "--url", f"{live_url}/openapi.json"]
    command += ["--output-path", "ricochet_client", "--meta", "none", "--config", "config.yml", "--fail-on-warning"]
    (folder / "config.yml").write_text("content_type_overrides: {application/jsonl: application/octet-stream}")
    environment = os.environ | {"PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}", "NO_PROXY": "*"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_generated_client_answers_the_case_of_the_paper(generated: Path, live_url: str) -> None:
    command = [sys.executable, "-W", "error", "-c", CONVERSATION, live_url]
    environment = os.environ | {"NO_PROXY": "*"}
    done = subprocess.run(command, cwd=generated, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr
