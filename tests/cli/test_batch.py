"""`ricochet batch`, `sweep` and `jobs`: computed by the worker pool of the command, and by a service."""

import csv
import json
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyarrow import parquet

from service import cli
from service.cache.cache import ResultCache
from service.cli.client import Client, connect
from service.schemas.strike import PAPER
from tests.api.many import searches, slow_strikes
from tests.cli.commands import COMMAND, LIMIT_S, case_at, environment, run, run_on_terminal, write_cases
from tests.conftest import until


def items_of(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_local_batch_equals_the_batch_of_a_service(folder: Path, live_url: str, client: httpx.Client) -> None:
    """Results are equal and in the order of the file. A case that the solver refuses does not stop the others."""
    short = {**case_at(238.0)["projectile"], "length_m": 0.05}
    cases = [*searches(5), case_at(238.0, projectile=short, custom_id="short"), *searches(5)]
    write_cases(folder / "cases.jsonl", *cases)
    local = run(folder, "batch", "cases.jsonl")
    remote = run(folder, "batch", "-", "--url", live_url, stdin=(folder / "cases.jsonl").read_text())
    assert (local.status, remote.status) == (3, 3), local.err + remote.err
    assert "11 cases, 1 of them with a problem" in local.err
    items = items_of(local.out)
    assert [item["index"] for item in items] == list(range(11))
    assert items[5]["custom_id"] == "short"
    assert items[5]["problem"]["errors"][0]["pointer"] == "/projectile/length_m"
    others = items_of(remote.out)
    assert items[:5] + items[6:] == others[:5] + others[6:]
    assert items[0]["result"] == client.post("/cra", json=cases[0]).json()


def test_sweep_writes_a_table_and_a_plot(folder: Path) -> None:
    axes = ["--axis", "impact.velocity_m_s=200:300:3", "--axis", "target.compressive_strength_pa=30e6,50e6"]
    done = run(folder, "sweep", "strike.toml", *axes, "--data-dir", "kept", "-o", "angles.csv", "--plot", "map.svg")
    assert (done.status, done.out) == (0, ""), done.err
    assert "6 cases, 0 of them with a problem" in done.err
    rows = list(csv.DictReader((folder / "angles.csv").read_text().splitlines()))
    assert {row["projectile.nose.shape"] for row in rows} == {PAPER["projectile"]["nose"]["shape"]}
    points = [(float(row["impact.velocity_m_s"]), float(row["target.compressive_strength_pa"])) for row in rows]
    assert points == [(v, s) for v in (200.0, 250.0, 300.0) for s in (30e6, 50e6)]
    for weak, strong in zip(rows[::2], rows[1::2], strict=True):
        assert float(weak["critical_angle_deg"]) > float(strong["critical_angle_deg"])
    assert "<!-- compressive strength [Pa] -->" in (folder / "map.svg").read_text()
    assert run(folder, "cache", "stat", RICOCHET_DATA_DIR="kept").out.startswith("6 results")
    assert run(folder, "cache", "stat", "--data-dir", "kept").out.startswith("6 results")


@pytest.mark.parametrize("form", ["--json", "--csv"])
def test_small_sweep_equals_the_sweep_of_a_service_without_starting_one(
    here: Path, live_url: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    """The solver refuses the second point, but computes the first. No local service is started."""
    monkeypatch.setattr("service.cli.server.local_server", None)
    args = ["sweep", "strike.toml", "--axis", "projectile.length_m=0.53,0.05", form]
    assert cli.main(args) == 3
    local = capsys.readouterr()
    assert cli.main([*args, "--url", live_url]) == 3
    remote = capsys.readouterr()
    assert local.err == remote.err == "2 cases, 1 of them with a problem\n"
    if form == "--csv":
        assert local.out == remote.out
    else:
        for ours, theirs in zip(items_of(local.out), items_of(remote.out), strict=True):
            ours.get("problem", {}).pop("instance", None)
            theirs.get("problem", {}).pop("instance", None)
            assert ours == theirs


def test_sweep_of_walls_omits_the_quantity_it_searches_for(served: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coarse = ("--set", "numerics.relative_tolerance=1e-3", "--axis", "impact.oblique_angle_deg=0,20")
    case = {**case_at(238.0), "search": {"tolerance_deg": 1.0}}
    case["target"] = {**case["target"], "thickness_m": 0.2}
    (served / "wall.json").write_text(json.dumps(case))
    for operation, name in (("thickness", "least_thickness_m"), ("limit-speed", "limit_speed_m_s")):
        args = ["sweep", "wall.json", "--operation", operation, *coarse]
        assert cli.main([*args, "--csv", "--plot", f"{operation}.svg"]) == 0
        rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
        assert [row["status"] for row in rows] == ["converged", "converged"]
        assert all(float(row["bracket_low" + name[name.index("_m") :]]) <= float(row[name]) for row in rows)
        assert (served / f"{operation}.svg").stat().st_size
    assert cli.main(["sweep", "wall.json", "--operation", "thickness", *coarse, "--thickness", "0.3"]) == 2
    assert "--thickness: must be absent" in capsys.readouterr().err


def test_sweep_of_studies_moves_the_scatter_with_the_axis(
    served: Path, client: httpx.Client, capsys: pytest.CaptureFixture[str]
) -> None:
    speed = {"type": "normal", "coefficient_of_variation": 0.02}
    case = {**case_at(238.0), "sampling": {"max_samples": 256}}
    case["impact"] = {**case["impact"], "oblique_angle_deg": 48.7}
    study = {**case, "uncertain": [{"field": "impact.velocity_m_s", "distribution": speed}]}
    (served / "study.json").write_text(json.dumps(study))
    args = ["sweep", "study.json", "--operation", "trajectory_uncertainty", "--axis", "impact.velocity_m_s=230,250"]
    assert cli.main([*args, "--csv", "--digits", "all", "--plot", "map.svg"]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert (served / "map.svg").stat().st_size
    for row in rows:
        velocity = float(row["impact.velocity_m_s"])
        alone = {"field": "impact.velocity_m_s", "distribution": {**speed, "mean": velocity}}
        impact = {**study["impact"], "velocity_m_s": velocity}
        answer = client.post("/trajectory/uncertainty", json={**study, "impact": impact, "uncertain": [alone]}).json()
        assert row["key"] == answer["key"]
        assert float(row["ricochet"]) == answer["outcomes"][0]["value"]


def test_table_of_a_batch_equals_the_table_of_the_service(
    served: Path, client: httpx.Client, capsys: pytest.CaptureFixture[str]
) -> None:
    cases = searches(3)
    write_cases(served / "cases.jsonl", *cases)
    job = client.post("/cra/batch", json={"cases": cases}, headers={"Prefer": "respond-async, wait=30"})
    assert job.status_code == 200
    assert cli.main(["batch", "cases.jsonl", "--csv", "--digits", "all"]) == 0
    table = capsys.readouterr().out
    newest = client.get("/jobs").json()["jobs"][0]["id"]
    expected = client.get(f"/jobs/{newest}/results", headers={"Accept": "text/csv"}).text
    assert table.splitlines() == expected.splitlines()


@pytest.fixture
def swept(client: httpx.Client) -> str:
    """Id of a sweep job of the paper's strike over five speeds."""
    axes = [{"field": "impact.velocity_m_s", "values": [238.0, 240.0, 242.0, 244.0, 246.0]}]
    job = client.post("/cra/sweep", json={"base": PAPER, "axes": axes}, headers={"Prefer": "respond-async"})
    return str(job.json()["id"])


def test_table_of_a_job_equals_the_table_of_the_service(
    served: Path,
    client: httpx.Client,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    swept: str,
) -> None:
    """Results are fetched in pages of two, but the header is printed once."""
    monkeypatch.setattr("service.cli.client.PAGE_SIZE", 2)
    assert cli.main(["jobs", "results", swept, "--csv", "--digits", "all"]) == 0
    table = client.get(f"/jobs/{swept}/results", headers={"Accept": "text/csv"}).text
    expected = table.replace("\r\n", "\n")
    assert expected.splitlines()[0].startswith("index,impact.velocity_m_s,custom_id,")
    assert capsys.readouterr().out == expected
    assert cli.main(["jobs", "results", swept, "-o", "results.csv", "--digits", "all"]) == 0
    assert (served / "results.csv").read_text() == expected


def test_parquet_of_a_job_has_the_rows_of_the_table(
    served: Path, capsysbinary: pytest.CaptureFixture[bytes], swept: str
) -> None:
    assert cli.main(["jobs", "results", swept, "-o", "results.parquet"]) == 0
    assert (
        cli.main(["jobs", "results", swept, "--csv", "-o", "table.parquet", "--digits", "all"]) == 0
    )  # The flag takes precedence over the file name.
    capsysbinary.readouterr()
    assert cli.main(["jobs", "results", swept, "--parquet"]) == 0
    assert capsysbinary.readouterr().out == (served / "results.parquet").read_bytes()
    rows = parquet.read_table(served / "results.parquet").to_pylist()
    expected = list(csv.DictReader((served / "table.parquet").read_text().splitlines()))
    assert [str(row["critical_angle_deg"]) for row in rows] == [row["critical_angle_deg"] for row in expected]
    assert [row["impact.velocity_m_s"] for row in rows] == [238.0, 240.0, 242.0, 244.0, 246.0]
    sweep = ["sweep", "strike.toml", "--axis", "impact.velocity_m_s=238:246:5", "-o", "again.parquet"]
    assert cli.main(sweep) == 0
    assert parquet.read_table(served / "again.parquet").to_pylist() == rows


def test_terminal_shows_the_first_rows_of_a_table_instead_of_json(folder: Path, live_url: str) -> None:
    args = ["sweep", "strike.toml", "--axis", "impact.velocity_m_s=200:300:26", "--url", live_url]
    args += ["--set", "search.tolerance_deg=1"]
    shown = run_on_terminal(folder, *args)
    assert shown.status == 0, shown.out
    assert "│" in shown.out
    assert "velocity m/s" in shown.out
    assert "and 6 more; --csv or --json prints all" in shown.out
    assert "computing" in shown.out  # This is the progress bar.
    assert '"index"' not in shown.out
    piped = run(folder, *args)
    assert len(items_of(piped.out)) == 26
    assert (piped.status, piped.err) == (0, "")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ('{"impact": 3}', "cases.jsonl:3: /projectile: is missing"),
        ("oops", "cases.jsonl:3: not JSON"),
        ("", "cases.jsonl:3: is empty"),
        (json.dumps(case_at(-1.0)), "cases.jsonl:3: /impact/velocity_m_s: must be 0.1 to 10,000 m/s, got"),
    ],
)
def test_invalid_line_is_named(served: Path, capsys: pytest.CaptureFixture[str], line: str, reason: str) -> None:
    good = json.dumps(case_at(238.0))
    (served / "cases.jsonl").write_text(f"{good}\n{good}\n{line}\n{good}\n")
    assert cli.main(["batch", "cases.jsonl"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert reason in captured.err
    assert cli.main(["batch", "nothing.jsonl"]) == 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("--axis impact.speed=1,2", "--axis impact.speed=1,2: unknown field; did you mean `impact.velocity_m_s`?"),
        ("--axis projectile.nose.width=1,2", "nose.width=1,2: unknown field"),
        ("--axis impact.velocity_m_s=300,-1", "--axis impact.velocity_m_s=300,-1: must be 0.1 to 10,000 m/s"),
        ("--axis impact.velocity_m_s=300 --mass -1", "--mass: must be 1e-6"),
        ("--axis impact.velocity_m_s=1:2:100000 --axis projectile.mass_kg=1:2:100000", "points; 100,000 at most"),
    ],
)
def test_invalid_sweep_is_named(served: Path, capsys: pytest.CaptureFixture[str], arguments: str, reason: str) -> None:
    assert cli.main(["sweep", "strike.toml", *arguments.split()]) == 2
    assert reason in capsys.readouterr().err


@pytest.mark.parametrize("axis", ["impact.velocity_m_s", "=1,2", "impact.velocity_m_s=1:2", "a.b=1:2:0", "a.b=x"])
def test_unknown_axis_is_a_usage_error(served: Path, capsys: pytest.CaptureFixture[str], axis: str) -> None:
    assert cli.main(["sweep", "strike.toml", "--axis", axis]) == 2
    assert "FIELD=START:STOP:COUNT" in capsys.readouterr().err


def test_jobs_can_be_listed_shown_cancelled_and_deleted(
    served: Path, client: httpx.Client, capsys: pytest.CaptureFixture[str]
) -> None:
    body = {"cases": slow_strikes(300)}
    name = client.post("/trajectory/batch", json=body, headers={"Prefer": "respond-async"}).json()["id"]
    assert cli.main(["jobs", "list"]) == 0
    header, *rows = capsys.readouterr().out.splitlines()
    assert header.endswith("jobs ahead  remaining s")
    assert any(line.startswith(f"{name}  trajectory") for line in rows)
    assert cli.main(["jobs", "show", name]) == 0
    assert re.search(r"jobs ahead +0\nremaining s +\d+\n", capsys.readouterr().out)
    assert cli.main(["jobs", "cancel", name]) == 0
    assert "dismissed" in capsys.readouterr().out
    assert cli.main(["jobs", "show", name, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "dismissed"
    assert cli.main(["jobs", "results", name]) == 1
    assert "it was cancelled" in capsys.readouterr().err
    assert cli.main(["jobs", "delete", name]) == 0
    assert cli.main(["jobs", "show", name]) == 2
    assert "there is no job with this id" in capsys.readouterr().err


def test_batch_waits_for_the_end_of_a_job_whose_results_are_complete(
    folder: Path, live_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last result can be read shortly before the status changes to successful, which is simulated here."""
    asked = Client.job
    ended: list[dict[str, Any]] = []

    def a_moment_before(client: Client, job_id: str) -> dict[str, Any]:
        job = asked(client, job_id)
        if job["status"] == "successful" and not ended:
            ended.append(job)
            return job | {"status": "running"}
        return job

    monkeypatch.setattr(Client, "job", a_moment_before)
    write_cases(folder / "cases.jsonl", *searches(2))
    done = run(folder, "batch", "cases.jsonl", "--url", live_url)
    assert (done.status, len(items_of(done.out)), len(ended)) == (0, 2, 1), done.err


def test_list_of_jobs_contains_all_pages(live_url: str, client: httpx.Client) -> None:
    body, headers = {"cases": searches(1)}, {"Prefer": "respond-async"}
    made = [client.post("/cra/batch", json=body, headers=headers).json()["id"] for _ in range(3)]

    def shorten(request: httpx.Request) -> None:
        request.url = request.url.copy_set_param("limit", 2)

    with connect(live_url, trust_env=False, event_hooks={"request": [shorten]}) as asking:
        assert [job["id"] for job in asking.jobs()][:3] == made[::-1]


@pytest.fixture
def interrupted(folder: Path) -> Iterator[Any]:
    """Return a function that runs a command in a new process group, and sends SIGINT once it prints something."""
    started: list[subprocess.Popen[str]] = []

    def interrupt(*arguments: str, **settings: str) -> tuple[int, str, str]:
        with (folder / "err").open("w") as err, (folder / "out").open("w") as out:
            process = subprocess.Popen(
                [*COMMAND, *arguments],
                cwd=folder,
                env=environment(**settings),
                stdout=out,
                stderr=err,
                text=True,
                start_new_session=True,
            )
        started.append(process)
        until(lambda: (folder / "out").stat().st_size > 0 or process.poll() is not None)
        assert process.poll() is None, (folder / "err").read_text()
        os.killpg(process.pid, signal.SIGINT)
        status = process.wait(LIMIT_S)
        return status, (folder / "out").read_text(), (folder / "err").read_text()

    yield interrupt
    for process in started:
        process.kill()
        process.wait()


def test_interrupted_batch_continues_at_the_service(
    folder: Path, live_url: str, client: httpx.Client, interrupted: Any
) -> None:
    write_cases(folder / "cases.jsonl", *slow_strikes(30))
    status, out, err = interrupted("batch", "cases.jsonl", "--operation", "trajectory", "--url", live_url)
    assert status == 130
    assert "Traceback" not in err
    begun = items_of(out)
    assert 0 < len(begun) < 30
    [hint, last] = err.splitlines()
    assert last == "interrupted"
    _, _, words = hint.partition("for its results: ricochet ")
    done = run(folder, *words.split())
    assert done.status == 0, done.err
    items = items_of(done.out)
    assert items[: len(begun)] == begun
    assert [item["index"] for item in items] == list(range(30))


def test_interrupted_local_batch_leaves_no_process_running(folder: Path, interrupted: Any) -> None:
    """The results so far are in the data folder, which is unlocked, and the command says how to continue."""
    write_cases(folder / "cases.jsonl", *slow_strikes(100))
    args = ("batch", "cases.jsonl", "--operation", "trajectory", "--data-dir", "kept")
    status, out, err = interrupted(*args)
    assert status == 130
    assert err.splitlines()[-1] == "interrupted"
    assert "the same command continues from there" in err
    assert "Traceback" not in err
    count = int(run(folder, "cache", "verify", RICOCHET_DATA_DIR="kept").out.split()[0])
    assert len(items_of(out)) <= count < 100


def test_folder_of_a_running_service_is_refused(folder: Path) -> None:
    write_cases(folder / "cases.jsonl", case_at(238.0))
    with ResultCache(folder / "data", memory_bytes=0, disk_bytes=10**9):
        done = run(folder, "batch", "cases.jsonl", "--data-dir", "data")
    assert (done.status, done.out) == (1, "")
    assert "in use by another service; use that service with --url" in done.err
    assert "Traceback" not in done.err


def test_closed_pipe_ends_the_command_quietly(folder: Path, live_url: str) -> None:
    write_cases(folder / "cases.jsonl", *searches(40))
    command = [*COMMAND, "batch", "cases.jsonl", "--url", live_url]
    with subprocess.Popen(
        command, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        err = process.stderr.read()
    assert process.returncode == 0
    assert err == ""
