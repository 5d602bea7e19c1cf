"""Request a table of critical ricochet angles from a running service: a sweep over speed and concrete, run as a job.

Start the service with `make serve`, then run `.venv/bin/python examples/batch.py [ADDRESS]`.
"""

import json
import sys
from collections.abc import Iterator
from typing import Any

import httpx

ADDRESS = "http://127.0.0.1:8000"
BASE = {
    "projectile": {
        "nose": {"shape": "ogive", "caliber_radius_head": 3.0},
        "diameter_m": 0.08,
        "length_m": 0.53,
        "mass_kg": 13.0,
    },
    "target": {"compressive_strength_pa": 39e6, "density_kg_m3": 2250.0},
    "impact": {"velocity_m_s": 238.0},
}
VELOCITIES_M_S = [240.0, 280.0, 320.0, 360.0, 400.0]
STRENGTHS_PA = [25e6, 40e6, 60e6, 90e6]
SWEEP = {
    "base": BASE,
    "axes": [  # The last axis varies fastest, so the results come row by row of the table.
        {"field": "impact.velocity_m_s", "values": VELOCITIES_M_S},
        {"field": "target.compressive_strength_pa", "values": STRENGTHS_PA},
    ],
}


def submit(client: httpx.Client) -> dict[str, Any]:
    """Submit the sweep as a job. Without `Prefer`, the response to so small a sweep would contain its results."""
    response = client.post("/cra/sweep", json=SWEEP, headers={"Prefer": "respond-async"})
    job: dict[str, Any] = checked(response).json()
    return job


def checked(response: httpx.Response) -> httpx.Response:
    """Return the response or, if it is an error, end the program with the title and detail of the problem."""
    if response.is_error:
        problem = response.json()
        sys.exit(f"{problem['title']}: {problem['detail']}")
    return response


def states(client: httpx.Client, job: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield every state of the job until it ends, from its server-sent events."""
    with client.stream("GET", job["links"]["events"]) as events:
        for line in events.raise_for_status().iter_lines():
            if line.startswith("data: "):
                yield json.loads(line.removeprefix("data: "))


def results(client: httpx.Client, job: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the results in the order of the sweep; they are requested page by page."""
    query: dict[str, str] | None = {}
    while query is not None:
        page = checked(client.get(job["links"]["results"], params=query)).json()
        yield from page["results"]
        query = {"cursor": page["next"]} if "next" in page else None


def described(item: dict[str, Any]) -> str:
    """Return the text of a cell: the angle, or the reason why there is none."""
    if "problem" in item:
        return str(item["problem"]["title"])
    answer = item["result"]
    return f"{answer['critical_angle_deg']:.2f}" if "critical_angle_deg" in answer else answer["status"]


def main() -> None:
    """Submit the sweep, print the progress of its job and then the table."""
    address = sys.argv[1] if len(sys.argv) > 1 else ADDRESS
    with httpx.Client(base_url=address, timeout=60.0) as client:
        try:
            job = submit(client)
        except httpx.TransportError as error:
            sys.exit(f"no service at {address} ({error}); `make serve` starts one")
        status = job["status"]
        for state in states(client, job):
            status, counts = state["status"], state["counts"]
            print(f"{status}: {counts['done']} of {counts['total']}, {counts['cached']} of them from the cache")
        if status != "successful":
            sys.exit(f"the job ended as {status}")
        cells = [described(item) for item in results(client, job)]
    print("\ncritical ricochet angle from the normal [°]\n")
    print("        " + "".join(f"{strength / 1e6:8.0f} MPa" for strength in STRENGTHS_PA))
    for row, velocity in enumerate(VELOCITIES_M_S):
        first = row * len(STRENGTHS_PA)
        print(f"{velocity:4.0f} m/s" + "".join(f"{cell:>12}" for cell in cells[first : first + len(STRENGTHS_PA)]))


if __name__ == "__main__":
    main()
