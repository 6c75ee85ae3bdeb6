import pytest
from arm_generator import Truth, at, record  # noqa: E402
from sim2real.diagnosis import explain_gap

# A diagnosis takes seconds: what several tests look at is made once.


def diagnosed(truth):
    """(diagnosis, its recording) of an arm."""
    log = record(truth)
    return explain_gap([log]), log


@pytest.fixture(scope="session")
def stuck():
    """Of an arm with 0.3 N m of Coulomb friction in joint 4."""
    return diagnosed(Truth(coulomb_positive=at(4, 0.3), coulomb_negative=at(4, 0.3)))


@pytest.fixture(scope="session")
def uneven():
    """Of an arm whose joint 1 rubs in one direction much more than in the other."""
    return diagnosed(Truth(coulomb_positive=at(1, 0.5), coulomb_negative=at(1, 0.1)))


@pytest.fixture(scope="session")
def loaded():
    """Of an arm that carries 0.3 kg."""
    return diagnosed(Truth(payload=0.3))
