"""What stands beside a joint posterior: each part may fail, and costs the posterior nothing."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import xarray as xr

from jbw.errors import Attempts
from jbw.identification.assemble import Report
from jbw.identification.gain_units import source_units
from jbw.identification.paper.sequential_vs_joint import compare_routes
from jbw.identification.procedure import Posteriors
from jbw.report.messages import stages
from jbw.study.collect import collect
from jbw.study.identifiability import Identifiability, look_again
from jbw.study.order import Order
from jbw.study.prepared import PreparedTests
from jbw.study.surroundings import constants_sentence


class Comparisons(NamedTuple):
    """What stands beside a joint posterior.

    Attributes:
        tree: The posteriors with verification and validation: every test predicted.
        identifiability: Which parameters the data know; None where it could not be made.
        routes: The paper's route beside the joint posterior; empty without one.
        statements: What the modes outside the band come to, and what could not be made.
    """

    tree: xr.DataTree
    identifiability: Identifiability | None
    routes: Mapping[str, Any] = {}
    statements: tuple[str, ...] = ()


def compare(
    order: Order, prepared: PreparedTests, posteriors: Posteriors, report: Report
) -> Comparisons:
    """Compare a posterior with the fit, every test, the modes outside the band and other routes.

    From here on the posterior is drawn: what cannot be made of it is left out and said.
    """
    attempts, joint, measured = Attempts(report), posteriors.joint, prepared.measured
    settings, fitted = order.campaign.settings, joint.fitted
    identifiability = attempts.make(
        stages.IDENTIFIABILITY, lambda: look_again(fitted, joint.draws, settings, report), None
    )
    tree = collect(order, measured, posteriors, attempts)
    source_unit = next(iter(source_units(measured.tests).values()), "")
    outside = attempts.make(
        stages.OUTSIDE_BAND,
        lambda: constants_sentence(joint.draws, joint.held, source_unit),
        None,
    )
    routes = attempts.make(stages.ROUTES, lambda: compare_routes(measured.linear, posteriors), {})
    statements = (*([outside] if outside else []), *attempts.said)
    return Comparisons(tree, identifiability, routes, statements)
