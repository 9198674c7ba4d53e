"""The types of `loads.json`: scalar results of predictions under other loads."""

from jbw.results.stored import Number, Stored


class LoadNumber(Stored):
    """A number of a predicted load with its 99 % band; `level` is stated if there are several."""

    load: str
    level: Number
    level_unit: str
    quantity: str
    low: float
    median: float
    high: float
    unit: str
