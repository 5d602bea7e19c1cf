"""Times of the maps of the page, and of a study of uncertainty that runs as a job, with two methods.

    python benchmarks/studies.py [--maps]

A map is a coarse grid that is answered directly, and then a job whose results are read while it runs.
"""

import argparse
import time
from typing import Any

import httpx

from benchmarks.machine import print_machine, print_table
from benchmarks.servers import service
from service.schemas.requests import ReportRequest
from service.schemas.strike import PAPER, PAPER_AT_45
from service.schemas.verdict import usual_inputs

SCATTER = usual_inputs(ReportRequest.model_validate(PAPER))[:5]
SCATTER[0]["distribution"]["coefficient_of_variation"] = 0.01
STUDY = PAPER | {"uncertain": SCATTER, "oblique_angles_deg": {"start": 30, "stop": 70, "count": 81}}

SPEEDS = {"field": "impact.velocity_m_s", "start": 140.0, "stop": 330.0}
STRENGTHS = {"field": "target.compressive_strength_pa", "start": 23e6, "stop": 55e6}
ANGLES = {"field": "impact.oblique_angle_deg", "start": 5.0, "stop": 85.0}
MAPS: tuple[tuple[str, dict[str, Any], dict[str, Any], int], ...] = (
    ("cra", PAPER, STRENGTHS, 60),
    ("trajectory", PAPER_AT_45, ANGLES, 40),
)
"""Operation, case, vertical axis, and number of values of each axis. The ranges are the defaults of the page."""
COARSE = 8
"""Number of values of each axis of the coarse grid."""
READ_SECONDS = 0.3
"""Shortest pause of the page between two requests for results of a job. [s]"""
PAGE = 1000
"""Number of results that the page requests at once."""


def draw(
    client: httpx.Client, operation: str, case: dict[str, Any], vertical: dict[str, Any], count: int
) -> list[object]:
    """Compute a map; return its name and size, the time until the coarse grid, and the time until all was read."""
    grid = {"base": case, "axes": [vertical | {"count": COARSE}, SPEEDS | {"count": COARSE}]}
    begun = time.perf_counter()
    answered = client.post(f"/{operation}/sweep", json=grid).raise_for_status().json()["results"]
    coarse = time.perf_counter() - begun
    grid["axes"] = [vertical | {"count": count}, SPEEDS | {"count": count}]
    job = client.post(f"/{operation}/sweep", json=grid, headers={"Prefer": "respond-async"}).json()
    cells, cursor = 0, ""
    while cells < count * count:
        page = client.get(f"/jobs/{job['id']}/results", params={"limit": PAGE, "cursor": cursor}).json()
        cells, cursor = cells + len(page["results"]), page.get("next", "")
        if not page["results"]:
            time.sleep(READ_SECONDS)
    if len(answered) != COARSE**2 or not all("result" in each for each in answered):
        raise RuntimeError("the coarse grid lacks results")
    return [operation, f"{count} x {count}", f"{coarse:.2f} s", f"{time.perf_counter() - begun:.1f} s"]


def study(client: httpx.Client, method: str, seed: int) -> list[object]:
    """Run a study; return its method and samples, and the times of first curve, answer and cached answer. [s]"""
    body = STUDY | {"sampling": {"method": method, "seed": seed}}
    begun, first = time.perf_counter(), 0.0
    job = client.post("/cra/uncertainty", json=body, headers={"Prefer": "respond-async"}).json()
    while job["status"] in ("accepted", "running"):
        time.sleep(0.02)
        job = client.get(job["links"]["self"]).json()
        if "partial" in job:
            first = first or time.perf_counter() - begun
    cold = time.perf_counter() - begun
    answer = client.post("/cra/uncertainty", json=body).json()
    times = first, cold, time.perf_counter() - begun - cold
    return [answer["method"], answer["samples"], *(f"{each:.3f} s" for each in times)]


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure maps and studies.")
    parser.add_argument("--maps", action="store_true", help="measure only the maps")
    options = parser.parse_args()
    print_machine()
    with service() as server, httpx.Client(base_url=server.url, timeout=120.0, trust_env=False) as client:
        print_table(["a map", "cases", "coarse picture", "every cell read"], [draw(client, *each) for each in MAPS])
        if not options.maps:  # Different seeds give new samples, none of which is cached.
            studies = [study(client, method, seed) for seed, method in enumerate(3 * ("auto", "direct"))]
            print_table(["a study", "samples", "first curve", "answer", "again"], studies)


if __name__ == "__main__":
    main()
