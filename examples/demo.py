"""Request the critical angle and two trajectories of the source paper's strike from a new service, each of them twice.

The script starts the service on a free port with an empty data folder, sends the requests, prints the answers and stops
the service. The exit status is 0 if angle and outcomes are as expected, and if the repeated requests, but no others,
were answered from the cache.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

EXPECTED_DEG, TOLERANCE_DEG = 48.63, 0.02
START_LIMIT_S = 1300.0  # The first start on a machine compiles the solver, which may take many minutes.
COMPILING_AFTER_S = 4.0  # A start without compilation takes less time.
STOP_LIMIT_S = 20.0

PROJECTILE = {
    "nose": {"shape": "ogive", "caliber_radius_head": 3.0},
    "diameter_m": 0.08,
    "length_m": 0.53,
    "mass_kg": 13.0,
}
TARGET = {"compressive_strength_pa": 39e6, "density_kg_m3": 2250.0}
VELOCITY_M_S = 238.0


class DemoError(Exception):
    """The demonstration failed."""


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def wait_until_ready(client: httpx.Client, process: subprocess.Popen[bytes]) -> float:
    """Poll /readyz and show how much of the solver is compiled; return the time until the service is ready. [s]"""
    begin = time.monotonic()
    shown = ""
    while (elapsed := time.monotonic() - begin) < START_LIMIT_S:
        if process.poll() is not None:
            raise DemoError(f"the service ended by itself with code {process.returncode}")
        try:
            if client.get("/readyz").status_code == httpx.codes.OK:
                return elapsed
        except httpx.TransportError:
            pass  # The service is not listening yet.
        if elapsed > COMPILING_AFTER_S:
            from solver.compilation import compilation_progress  # noqa: PLC0415 (takes a second, and is seldom needed)

            progress = compilation_progress()
            if progress.left and str(progress) != shown:
                shown = str(progress)
                print(shown, flush=True)
        time.sleep(2.0 if shown else 0.1)
    raise DemoError(f"the service was not ready after {START_LIMIT_S:.0f} s")


@contextmanager
def service(log: Path, data: Path) -> Iterator[httpx.Client]:
    """Run the service during the block, and yield a client."""
    port = free_port()
    environment = os.environ | {
        "RICOCHET_HOST": "127.0.0.1",
        "RICOCHET_PORT": str(port),
        "RICOCHET_DATA_DIR": str(data),
    }
    command = [str(Path(sys.executable).with_name("ricochet")), "serve"]
    with (
        log.open("wb") as output,
        subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT) as process,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0, trust_env=False) as client,
    ):
        try:
            print(f"starting the service on port {port}", flush=True)
            print(f"ready after {wait_until_ready(client, process):.1f} s")
            yield client
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise DemoError(f"the service did not stop within {STOP_LIMIT_S:.0f} s of SIGTERM") from None
    if process.returncode != 0:
        raise DemoError(f"the service ended with code {process.returncode}")


def post(client: httpx.Client, path: str, body: dict[str, Any], *, cached: bool) -> tuple[dict[str, Any], float]:
    """Send a request; return its answer and time [ms].

    Raises
    ------
    DemoError
        If the request fails, or if the answer came from the cache although `cached` is false, or the reverse.
    """
    begin = time.perf_counter()
    response = client.post(path, json=body)
    elapsed = (time.perf_counter() - begin) * 1e3
    if response.status_code != httpx.codes.OK:
        raise DemoError(f"POST {path} answered {response.status_code}: {response.text}")
    status = response.headers.get("Cache-Status", "")
    if ("hit" in status) is not cached:
        raise DemoError(f"POST {path}: expected a {'hit' if cached else 'miss'}, the service says {status!r}")
    return response.json(), elapsed


def ask_critical_angle(client: httpx.Client) -> float:
    """Request the critical angle twice, and print its search; return the angle. [°]"""
    body = {"projectile": PROJECTILE, "target": TARGET, "impact": {"velocity_m_s": VELOCITY_M_S}}
    answer, computed = post(client, "/cra", body, cached=False)
    again, cached = post(client, "/cra", body, cached=True)
    if again != answer:
        raise DemoError("the cached answer is not the computed one")
    print("\nPOST /cra: angles in degrees from the normal\n")
    print("  trial    angle   nose tip at the end   outcome")
    for number, trial in enumerate(answer["iterations"], start=1):
        tip = trial["final_position_m"]
        print(f"  {number:5d}  {trial['oblique_angle_deg']:7.3f}   {tip:+17.4f} m   {trial['outcome']}")
    angle: float = answer.get("critical_angle_deg", float("nan"))
    print(f"\n  critical ricochet angle: {angle:.3f}° ({answer['status']})")
    print(f"  computed in {computed:.0f} ms, from the cache in {cached:.1f} ms")
    return angle


def ask_trajectory(client: httpx.Client, oblique_angle_deg: float) -> str:
    """Request a trajectory twice, and print a summary; return its outcome."""
    impact = {"velocity_m_s": VELOCITY_M_S, "oblique_angle_deg": oblique_angle_deg}
    body = {"projectile": PROJECTILE, "target": TARGET, "impact": impact}
    answer, computed = post(client, "/trajectory", body, cached=False)
    _, cached = post(client, "/trajectory", body, cached=True)
    depth, rows = answer["maximum_depth_m"], len(answer["history"]["time_s"])
    print(f"\nPOST /trajectory at {oblique_angle_deg:g}°: {answer['outcome']}, {depth:.3f} m deep at most, {rows} rows")
    print(f"  computed in {computed:.0f} ms, from the cache in {cached:.1f} ms")
    for warning in answer["warnings"]:
        print(f"  {warning['code']}: {warning['detail']}")
    outcome: str = answer["outcome"]
    return outcome


def main() -> int:
    """Run the demonstration; return 0 if everything is as expected."""
    with tempfile.TemporaryDirectory(prefix="ricochet-") as folder:
        log = Path(folder) / "service.log"
        try:
            with service(log, Path(folder) / "data") as client:
                angle = ask_critical_angle(client)
                outcomes = [ask_trajectory(client, oblique_angle_deg) for oblique_angle_deg in (45.0, 55.0)]
            if not abs(angle - EXPECTED_DEG) <= TOLERANCE_DEG:
                raise DemoError(f"expected {EXPECTED_DEG} ± {TOLERANCE_DEG}°, got {angle}°")
            if outcomes != ["embedded", "ricochet"]:
                raise DemoError(f"expected embedded at 45° and ricochet at 55°, got {outcomes}")
        except (DemoError, httpx.HTTPError) as error:
            print(f"\nthe demonstration failed: {error}", file=sys.stderr)
            print(log.read_text(errors="replace"), file=sys.stderr)
            return 1
    print(f"\nas expected: {EXPECTED_DEG} ± {TOLERANCE_DEG}°")
    return 0


if __name__ == "__main__":
    sys.exit(main())
