import pytest

from validation.depth_tests import Assessment, assess


@pytest.fixture(scope="session")
def assessment() -> Assessment:
    return assess(lambda what: None)
