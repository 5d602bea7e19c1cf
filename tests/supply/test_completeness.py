"""`tests.completeness`: tests that did not run in CI are found, and results of slow tests recorded."""

from tests.completeness import (
    COLUMNS,
    SKIPS,
    SLOW,
    Result,
    faults,
    name_in_report,
    read_report,
    read_table,
    record,
)

REPORT = """<testsuites><testsuite>
<testcase classname="tests.a.test_one" name="test_runs[b/c.d::e]" time="1.5"/>
<testcase classname="tests.a.test_one.TestClass" name="test_method" time="0.1"><failure message="wrong"/></testcase>
<testcase classname="tests.a.test_one" name="test_skipped" time="0.1"><skipped message="no browser here"/></testcase>
</testsuite></testsuites>"""
RAN, METHOD, SKIPPED, SLOW_ONE, LEFT_OUT = (
    f"tests/a/test_one.py::{name}"
    for name in ("test_runs[b/c.d::e]", "TestClass::test_method", "test_skipped", "test_slow", "test_left_out")
)
RESULTS = read_report(REPORT)
REASONS = [("tests/a/", "no browser")]


def test_pytest_report_has_outcome_time_and_reason() -> None:
    assert RESULTS[name_in_report(RAN)] == Result("passed", 1.5)
    assert RESULTS[name_in_report(METHOD)] == Result("failed", 0.1)
    assert RESULTS[name_in_report(SKIPPED)] == Result("skipped", 0.1, "no browser here")


def test_run_of_all_but_the_slow_ones_is_complete() -> None:
    assert faults([RAN, METHOD, SKIPPED, SLOW_ONE], RESULTS, [SLOW_ONE], REASONS) == []


def test_tests_that_did_not_run_are_named() -> None:
    assert faults([RAN, LEFT_OUT], RESULTS, [], REASONS) == [f"{LEFT_OUT} was left out"]
    [skipped] = faults([SKIPPED], RESULTS, [], [("tests/b/", "no browser")])
    assert skipped.startswith(f"{SKIPPED} was skipped")
    assert skipped.endswith("no browser here")


def test_list_of_slow_tests_contains_only_slow_tests() -> None:
    [gone] = faults([RAN], RESULTS, [SLOW_ONE], REASONS)
    assert gone.startswith(SLOW_ONE)
    [ran] = faults([RAN], RESULTS, [RAN], REASONS)
    assert ran.startswith(RAN)


def test_results_of_slow_tests_are_recorded_and_others_kept() -> None:
    rows = [dict.fromkeys(COLUMNS, "before") | {"test": test} for test in (RAN, SKIPPED, SLOW_ONE)]
    entered = record(RESULTS, rows)
    assert [row["result"] for row in entered] == ["passed", "before", "before"]
    assert entered[0]["seconds"] == "2"


def test_tables_of_slow_and_skipped_tests_have_all_columns() -> None:
    assert all(tuple(row) == COLUMNS for row in read_table(SLOW))
    assert all(row.keys() == {"tests", "reason", "why"} and all(row.values()) for row in read_table(SKIPS))
