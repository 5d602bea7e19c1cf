"""Example of a Python program that uses a client generated from the contract.

    openapi-python-client generate --path openapi/openapi.json --output-path ricochet_client --meta none \
        --config clients/python/config.yml
    PYTHONPATH=. python tests/clients/python/conversation.py http://127.0.0.1:8000
"""
# mypy: ignore-errors
# The package exists only after the client has been generated.

import io
import json
import os
import sys
import time

from ricochet_client import Client, models
from ricochet_client.api.calibration import calibrate_by_depth, calibrate_by_motion, calibrate_over_obliquity
from ricochet_client.api.critical_ricochet_angle import find_critical_angle, find_critical_angles, sweep_critical_angles
from ricochet_client.api.health import livez, metrics, readyz, version
from ricochet_client.api.jobs import cancel_job, delete_job, follow_job, get_job, get_job_results, list_jobs
from ricochet_client.api.results import get_result
from ricochet_client.api.trajectory import compute_trajectories, compute_trajectory
from ricochet_client.types import UNSET, File

NOSE = models.OgiveNose(shape="ogive", caliber_radius_head=3.0)
PROJECTILE = models.Projectile(nose=NOSE, diameter_m=0.08, length_m=0.53, mass_kg=13.0)
TOO_SHORT = models.Projectile(nose=NOSE, diameter_m=0.08, length_m=0.1, mass_kg=13.0)
TARGET = models.Target(compressive_strength_pa=39e6, density_kg_m3=2250.0)
PAPER = models.CriticalAngleRequest(projectile=PROJECTILE, target=TARGET, impact=models.Strike(velocity_m_s=238.0))
ROUGH = models.Search(lower_deg=40.0, upper_deg=80.0, tolerance_deg=1.0)

client = Client(base_url=sys.argv[1], raise_on_unexpected_status=True)


def find_one_angle() -> None:
    found = find_critical_angle.sync(client=client, body=PAPER)
    assert isinstance(found, models.CriticalAngleAnswer)
    assert found.status == models.SearchStatus.CONVERGED
    assert abs(found.critical_angle_deg - 48.63) < 0.05, found.critical_angle_deg
    assert found.iterations[0].outcome == models.Outcome.EMBEDDED
    assert found.trajectory is UNSET
    assert get_result.sync(client=client, key=found.key) == found
    assert models.CriticalAngleRequest.from_dict(PAPER.to_dict()) == PAPER


def compute_some_motions() -> None:
    for oblique_angle_deg, outcome in ((45.0, models.Outcome.EMBEDDED), (55.0, models.Outcome.RICOCHET)):
        impact = models.Impact(velocity_m_s=238.0, oblique_angle_deg=oblique_angle_deg)
        shot = models.TrajectoryRequest(projectile=PROJECTILE, target=TARGET, impact=impact)
        answer = compute_trajectory.sync(client=client, body=shot)
        assert isinstance(answer, models.TrajectoryAnswer)
        assert answer.outcome == outcome
        assert answer.history.time_s[-1] == answer.final.time_s
        shot.output = models.TrajectoryOutput(history=False)
        assert compute_trajectory.sync(client=client, body=shot).history is UNSET
        assert get_result.sync(client=client, key=answer.key) == answer


def find_some_at_once() -> None:
    found = find_critical_angle.sync(client=client, body=PAPER)
    named = models.CriticalAngleCase(
        projectile=PROJECTILE, target=TARGET, impact=models.Strike(velocity_m_s=238.0), custom_id="paper"
    )
    some = find_critical_angles.sync(client=client, body=models.CriticalAngleBatch(cases=[named, named]))
    assert isinstance(some, models.CriticalAngleResults)
    assert [(item.index, item.custom_id) for item in some.results] == [(0, "paper"), (1, "paper")]
    assert [item.result for item in some.results] == [found, found]
    assert some.results[0].problem is UNSET

    axis = models.Axis(field="impact.velocity_m_s", start=230.0, stop=238.0, count=2)
    base = models.CriticalAngleBase(projectile=PROJECTILE, target=TARGET, impact=models.Strike(velocity_m_s=238.0))
    swept = sweep_critical_angles.sync(client=client, body=models.CriticalAngleSweep(base=base, axes=[axis]))
    assert isinstance(swept, models.CriticalAngleResults)
    assert swept.results[1].result == found


def calibrate() -> None:
    tests = [
        models.DepthTest(velocity_m_s=v, depth_m=z)
        for v, z in ((238.1, 0.3), (275.7, 0.38), (314.0, 0.45), (369.5, 0.53))
    ]
    deep = calibrate_by_depth.sync(
        client=client, body=models.DepthCalibrationRequest(projectile=PROJECTILE, target=TARGET, tests=tests)
    )
    assert isinstance(deep, models.DepthCalibrationAnswer)
    assert abs(deep.strength_factor - 8.44) < 0.02
    assert deep.curves is UNSET

    shot = models.TrajectoryRequest(
        projectile=PROJECTILE, target=TARGET, impact=models.Impact(velocity_m_s=238.0, oblique_angle_deg=40.0)
    )
    moved = compute_trajectory.sync(client=client, body=shot).history
    history = models.MotionRecord(
        time_s=moved.time_s, rotation_deg=[angle - moved.axis_angle_deg[0] for angle in moved.axis_angle_deg]
    )
    oblique = calibrate_by_motion.sync(
        client=client,
        body=models.MotionCalibrationRequest(projectile=PROJECTILE, target=TARGET, impact=shot.impact, history=history),
    )
    assert isinstance(oblique, models.MotionCalibrationAnswer)
    assert abs(oblique.strength_factor - (8.469 + 0.0149 * 40.0 - 0.0013 * 40.0**2)) < 0.01
    assert oblique.residuals.time_s == moved.time_s
    assert oblique.residuals.depth_displacement_m is UNSET

    points = [
        models.ObliquityPoint(oblique_angle_deg=angle, strength_factor=fit.strength_factor, standard_error=0.1)
        for angle, fit in ((0.0, deep), (40.0, oblique))
    ]
    fit = calibrate_over_obliquity.sync(client=client, body=models.ObliquityCalibrationRequest(points=points, order=1))
    assert isinstance(fit, models.ObliquityCalibrationAnswer)
    for answer in (deep, oblique, fit):
        assert get_result.sync(client=client, key=answer.key) == answer
    body = models.CriticalAngleRequest(
        projectile=PROJECTILE,
        target=TARGET,
        impact=models.Strike(velocity_m_s=238.0),
        resistance=models.Resistance(strength_factor=fit.strength_factor_model),
    )
    found = find_critical_angle.sync(client=client, body=body)
    assert 0.0 < found.critical_angle_standard_error_deg < 2.0


def rough(velocity: float, custom_id: str) -> models.CriticalAngleCase:
    strike = models.Strike(velocity_m_s=velocity)
    return models.CriticalAngleCase(
        projectile=PROJECTILE, target=TARGET, impact=strike, search=ROUGH, custom_id=custom_id
    )


def follow_a_job() -> None:
    cases = [rough(270.0 + 0.01 * number, f"case-{number}") for number in range(24)]
    lines = "".join(json.dumps(case.to_dict()) + "\n" for case in cases).encode()
    token = f"conversation-{os.getpid()}-{time.time_ns()}"
    submitted = [
        find_critical_angles.sync_detailed(
            client=client, body=File(payload=io.BytesIO(lines)), prefer="respond-async", idempotency_key=token
        )
        for _ in range(2)
    ]
    assert [response.status_code for response in submitted] == [202, 202]
    first, again = (response.parsed for response in submitted)
    assert isinstance(first, models.Job)
    assert first.operation == models.JobOperation.CRA
    assert again.id == first.id
    assert submitted[0].headers["Location"] == first.links.self_

    job = first
    while job.status in (models.JobStatus.ACCEPTED, models.JobStatus.RUNNING):
        time.sleep(0.1)
        job = get_job.sync(client=client, job_id=first.id)
    assert (job.status, job.counts.total, job.counts.failed) == (models.JobStatus.SUCCESSFUL, 24, 0)
    assert job.created <= job.started <= job.finished < job.expires
    events = follow_job.sync(client=client, job_id=first.id)
    received = [line.removeprefix("data: ") for line in events.splitlines() if line.startswith("data: ")]
    assert [models.Job.from_dict(json.loads(each)) for each in received] == [job]

    items, cursor = [], ""
    while cursor is not UNSET:
        page = get_job_results.sync(client=client, job_id=first.id, cursor=cursor, limit=10)
        assert isinstance(page, models.JobResults)
        items += page.results
        cursor = page.next_
    assert [item.index for item in items] == list(range(24))
    assert [item.custom_id for item in items] == [case.custom_id for case in cases]
    assert all(isinstance(item.result, models.CriticalAngleAnswer) for item in items)
    # Other formats are requested with the HTTP client that the generated client wraps.
    table = client.get_httpx_client().get(first.links.results, headers={"Accept": "text/csv"})
    assert len(table.text.splitlines()) == 1 + 24

    assert cancel_job.sync(client=client, job_id=first.id) == job
    assert first.id in [each.id for each in list_jobs.sync(client=client).jobs]


def cancel_a_job() -> None:
    # The job is so slow that it is still running when it is cancelled.
    numerics = models.Numerics(method=models.Method.PANELS, panels=20_000)
    strikes = [models.Impact(velocity_m_s=280.0 + 1e-3 * number, oblique_angle_deg=50.0) for number in range(200)]
    cases = [
        models.TrajectoryCase(projectile=PROJECTILE, target=TARGET, impact=impact, numerics=numerics)
        for impact in strikes
    ]
    job = compute_trajectories.sync(client=client, body=models.TrajectoryBatch(cases=cases), prefer="respond-async")
    assert isinstance(job, models.Job)
    cancelled = cancel_job.sync(client=client, job_id=job.id)
    assert cancelled.status == models.JobStatus.DISMISSED
    assert cancelled.counts.done < cancelled.counts.total == 200
    assert cancel_job.sync(client=client, job_id=job.id) == cancelled
    partial = get_job_results.sync(client=client, job_id=job.id)
    assert len(partial.results) <= cancelled.counts.done
    assert delete_job.sync_detailed(client=client, job_id=job.id).status_code == 204
    gone = get_job.sync(client=client, job_id=job.id)
    assert isinstance(gone, models.Problem)
    assert gone.status == 404


def get_problems() -> None:
    strike = models.Strike(velocity_m_s=238.0)
    short = models.CriticalAngleCase(projectile=TOO_SHORT, target=TARGET, impact=strike)
    one = find_critical_angle.sync(
        client=client, body=models.CriticalAngleRequest(projectile=TOO_SHORT, target=TARGET, impact=strike)
    )
    assert isinstance(one, models.Problem)
    assert [error.pointer for error in one.errors] == ["/projectile/length_m"]
    many = find_critical_angles.sync(client=client, body=models.CriticalAngleBatch(cases=[rough(238.0, "good"), short]))
    assert isinstance(many, models.Problem)
    assert [error.pointer for error in many.errors] == ["/cases/1/projectile/length_m"]
    line = find_critical_angles.sync(client=client, body=File(payload=io.BytesIO(b'{"impact": 1}\n')))
    assert isinstance(line, models.Problem)
    assert "/0/impact" in [error.pointer for error in line.errors]
    tests = [models.DepthTest(velocity_m_s=238.1, depth_m=0.3)] * 2
    shots = models.DepthCalibrationRequest(projectile=TOO_SHORT, target=TARGET, tests=tests)
    fit = calibrate_by_depth.sync(client=client, body=shots)
    assert isinstance(fit, models.Problem)
    assert [error.pointer for error in fit.errors] == ["/projectile/length_m"]
    axis = models.Axis(field="impact.velocity", values=[238.0])
    base = models.CriticalAngleBase(projectile=PROJECTILE, target=TARGET, impact=strike)
    sweep = sweep_critical_angles.sync(client=client, body=models.CriticalAngleSweep(base=base, axes=[axis]))
    assert isinstance(sweep, models.Problem)
    assert [error.pointer for error in sweep.errors] == ["/axes/0/field"]
    assert isinstance(get_result.sync(client=client, key="0" * 64), models.Problem)


def ask_how_it_is() -> None:
    assert livez.sync(client=client).status == readyz.sync(client=client).status == "ok"
    assert "numpy" in version.sync(client=client).libraries
    assert "ricochet_" in metrics.sync(client=client)


if __name__ == "__main__":
    for part in (
        find_one_angle,
        compute_some_motions,
        find_some_at_once,
        calibrate,
        follow_a_job,
        cancel_a_job,
        get_problems,
        ask_how_it_is,
    ):
        part()
        sys.stdout.write(f"{part.__name__}\n")
