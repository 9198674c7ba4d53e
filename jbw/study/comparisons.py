r"""Analyses that follow a joint posterior; if one fails, the posterior is kept.

The influence of the modes outside a band is stated in a campaign's own units. Near the joint's own
mode both residual terms act as one real constant: as an inertance

$$c = -g\,(\omega_n^2 U + L)$$

which is that of a rigid body, 1/M, where it is positive; otherwise the modes above the band give
the structure a compliance $-c / \omega_n^2$.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jbw.errors import Attempts
from jbw.freeform.free_law import FreeLaw
from jbw.identification.assemble import Report
from jbw.identification.gain_units import source_units
from jbw.identification.paper.routes import compare_routes
from jbw.identification.procedure import Posteriors
from jbw.inference.posterior.summary import QUANTILES
from jbw.observables.residual_terms import LOWER, UPPER
from jbw.quantities import gain_unit, per
from jbw.report.messages import stages
from jbw.report.messages import study as messages
from jbw.report.text import interval
from jbw.study.collect import collect
from jbw.study.free_group import free_law_of
from jbw.study.identifiability import Identifiability, look_again
from jbw.study.order import Order
from jbw.study.prepared import PreparedTests


class Comparisons(NamedTuple):
    """The results of the analyses that follow a joint posterior.

    Attributes:
        tree: The posteriors with verification and validation: predictions of every test.
        identifiability: How well the data constrain each parameter; None if the analysis failed.
        without_form: The law that the readings alone determine; None for several modes or too few
            readings.
        routes: The comparison of the paper's route with the joint posterior; empty without that
            route.
        statements: Sentences on the modes outside the band and on analyses that failed.
    """

    tree: xr.DataTree
    identifiability: Identifiability | None
    routes: Mapping[str, Any] = {}
    without_form: FreeLaw | None = None
    statements: tuple[str, ...] = ()


def compare(
    order: Order, prepared: PreparedTests, posteriors: Posteriors, report: Report
) -> Comparisons:
    """Compare a posterior with its fit, with all tests and with other methods.

    The posterior has been drawn: an analysis that fails is left out and reported.
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
    without_form = attempts.make(
        stages.WITHOUT_FORM,
        lambda: free_law_of(prepared.look, measured, order.seed, named=False),
        None,
    )
    statements = (*([outside] if outside else []), *attempts.said)
    return Comparisons(tree, identifiability, routes, without_form, statements)


def constants_sentence(posterior: xr.Dataset, held: Mapping[str, float], source: str) -> str | None:
    """Return the sentence on the constant response of modes outside the band; None if not modelled.

    `source` is the unit of the quantity that drives the tests.
    """
    constants = {**held, **{str(name): draws.values for name, draws in posterior.items()}}
    if not {UPPER, LOWER} & constants.keys() or not {"gain", "omega_n"} <= constants.keys():
        return None
    stiff = np.asarray(constants["omega_n"]) ** 2
    inertance = -constants["gain"] * (stiff * constants.get(UPPER, 0.0) + constants.get(LOWER, 0.0))
    if np.median(inertance) > 0:
        unit = gain_unit(source).replace("N/kg", "m/s^2")
        return messages.rigid_body(_spread(inertance), unit)
    return messages.compliance(_spread(-inertance / stiff), per("m", source))


def _spread(draws: np.ndarray) -> str:
    return interval(*np.quantile(draws, QUANTILES))
