"""How much time and memory does it take to reduce a finite-element model with joints?

A portal frame of more and more beam elements, with two joints, is reduced to its modes up to 400 Hz
with residual modes. The number of kept modes stays the same, so that only the cost of sparse
algebra grows; later steps do not depend on the size of the model. The first frequency shows the
round-off of double precision: the condition number of a beam's stiffness grows with the fourth
power of the number of elements, whatever the method.

    python benchmarks/assemblies_reduction.py [--calls 3] [--json FILE]
"""

import resource
from collections.abc import Sequence

from timing import Table, options, show, take_turns

import jbw

# number of elements in each of three members, with three degrees of freedom per node
ELEMENTS = (100, 400, 1100)
COLUMNS = {"degrees of freedom": "d", "modes": "d", "first, Hz": ".6f", "reduction, s": ".2f"}
COLUMNS |= {"of a process, GB": ".2f"}


def tables(calls: int) -> list[Table]:
    """Return the table of times by size, with the process's largest memory so far."""
    frames = {str(n): jbw.rig.portal_frame(elements=n) for n in ELEMENTS}
    times = take_turns({name: frame.reduced for name, frame in frames.items()}, calls)
    rows = []
    for name, frame in frames.items():
        reduced = frame.reduced()
        gigabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        size, modes = frame.model.num_dofs, reduced.num_kept
        rows.append((size, modes, reduced.frequencies_hz[0], times[name].least, gigabytes))
    return [Table("Reduction of a portal frame", COLUMNS, rows)]


def main(arguments: Sequence[str] | None = None) -> None:
    chosen = options(__doc__, calls=3).parse_args(arguments)
    show(tables(chosen.calls), ("scipy",), chosen.json)


if __name__ == "__main__":
    main()
