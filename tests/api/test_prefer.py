"""Parsing of the `Prefer` header."""

import pytest

from service.api.batch_response import Preference, read_preference


@pytest.mark.parametrize(
    ("headers", "respond_async", "wait"),
    [
        ([], False, None),
        ([""], False, None),
        (["respond-async"], True, None),
        (["RESPOND-ASYNC"], True, None),
        (["respond-async, wait=10"], True, 10),
        (["wait=10", "Respond-Async"], True, 10),
        (["  wait = 10 ;x=y , respond-async;  foo=bar"], True, 10),
        (['wait="10"'], False, 10),
        (["wait=0"], False, 0),
        (["wait=10, wait=20"], False, 10),
        (["wait=ten"], False, None),
        (["wait=-1"], False, None),
        (["wait=1.5"], False, None),
        (["wait"], False, None),
        (["wait=99999999999999999999"], False, 999_999_999),
        (["wait=\u0663"], False, None),
        (['handling=lenient; x="respond-async, wait=1"'], False, None),
        (['foo="respond-async"'], False, None),
        (['foo="a\\"b, respond-async", wait=3'], False, 3),
        (["not-respond-async, respond-asynchronously"], False, None),
        (["return=minimal,,,respond-async,"], True, None),
    ],
)
def test_preference_is_parsed_as_the_standard_says(headers: list[str], respond_async: bool, wait: int | None) -> None:
    assert read_preference(headers) == Preference(respond_async, wait)


def test_no_header_takes_long_to_parse() -> None:
    for text in ('"' * 60_000, "a=" * 30_000, ";" * 60_000, '"\\' * 30_000, "wait=" + "1" * 60_000, ', "' * 20_000):
        assert not read_preference([text]).respond_async


@pytest.mark.parametrize(
    ("preference", "waited", "told"),
    [
        (Preference(), None, None),
        (Preference(True), None, "respond-async"),
        (Preference(True, 10), 10, "respond-async, wait=10"),
        (Preference(False, 100), 30.0, "wait=30"),
    ],
)
def test_applied_preferences_are_named(preference: Preference, waited: float | None, told: str | None) -> None:
    assert preference.applied(waited).get("Preference-Applied") == told
