"""The register of kinds of tests: one file and one class per kind.

A kind that is defined elsewhere, in a test or a notebook, is added by `register` and is then part
of every identification whose campaign has such tests.
"""

from jbw.observables.controlled import ControlledPoints
from jbw.observables.decay import Decays
from jbw.observables.loops import Loops
from jbw.observables.modal_decays import ModalDecays
from jbw.observables.observable import Observable
from jbw.observables.records import Records
from jbw.observables.steady import Points

# The parts of a dataset have the order of this list. The fit of spectral lines (Step 2 of the
# paper) is not listed, because its estimates are added separately.
OBSERVABLES: list[type[Observable]] = [
    Records,
    Points,
    Loops,
    Decays,
    ModalDecays,
    ControlledPoints,
]


def register(observable: type[Observable]) -> type[Observable]:
    """Add a class to the register for its kinds of tests; it can be used as a decorator."""
    if observable not in OBSERVABLES:
        OBSERVABLES.append(observable)
    return observable


def taking(*, several: bool) -> list[type[Observable]]:
    """Return the classes that support tests of several modes (`several`), or of one mode."""
    return [kind for kind in OBSERVABLES if kind.several in (None, several)]
