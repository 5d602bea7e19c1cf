"""How long does a study of uncertainty take as a job, by either method: first curve, answer, answer from the cache?"""

import time

import httpx

from benchmarks.servers import service
from service.schemas.requests import ReportRequest
from service.schemas.strike import PAPER
from service.schemas.verdict import usual_inputs

SCATTER = usual_inputs(ReportRequest.model_validate(PAPER))[:5]
SCATTER[0]["distribution"]["coefficient_of_variation"] = 0.01
STUDY = PAPER | {"uncertain": SCATTER, "oblique_angles_deg": {"start": 30, "stop": 70, "count": 81}}


def main() -> None:
    """Measure and print."""
    with service() as server, httpx.Client(base_url=server.url, timeout=120.0, trust_env=False) as client:
        for seed, method in enumerate(3 * ("auto", "direct")):  # no sample is of another study
            body = STUDY | {"sampling": {"method": method, "seed": seed}}
            seconds: dict[str, float] = {}
            begun = time.perf_counter()
            job = client.post("/cra/uncertainty", json=body, headers={"Prefer": "respond-async"}).json()
            while job["status"] in ("accepted", "running"):
                time.sleep(0.02)
                job = client.get(job["links"]["self"]).json()
                if "partial" in job:
                    seconds.setdefault("first curve", time.perf_counter() - begun)
            seconds["cold"] = time.perf_counter() - begun
            answer = client.post("/cra/uncertainty", json=body).json()
            seconds["again"] = time.perf_counter() - begun - seconds["cold"]
            print(answer["method"], answer["samples"], {name: round(value, 3) for name, value in seconds.items()})


if __name__ == "__main__":
    main()
