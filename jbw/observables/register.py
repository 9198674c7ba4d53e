"""The register of kinds of tests: one file and one class a kind, one line of registration here.

A kind that is defined elsewhere, in a test or a notebook, joins by `register` and is then part of
every identification whose campaign has such tests.
"""

from jbw.observables.controlled import ControlledPoints
from jbw.observables.decay import Decays
from jbw.observables.loops import Loops
from jbw.observables.modal_decays import ModalDecays
from jbw.observables.observable import Observable
from jbw.observables.records import Records
from jbw.observables.steady import Points

# In the order of the parts of a dataset. What a line fit reads of noise is Step 2's to add.
OBSERVABLES: list[type[Observable]] = [
    Records,
    Points,
    Loops,
    Decays,
    ModalDecays,
    ControlledPoints,
]


def register(observable: type[Observable]) -> type[Observable]:
    """Make an observable take its kinds of tests; usable as a decorator."""
    if observable not in OBSERVABLES:
        OBSERVABLES.append(observable)
    return observable


def taking(*, several: bool) -> list[type[Observable]]:
    """Return the observables that take tests of a structure with several modes, or one."""
    return [kind for kind in OBSERVABLES if kind.several in (None, several)]
