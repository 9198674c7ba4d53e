"""Campaign lines that remedies of findings propose, pasted into a campaign file and checked."""

import re

from jbw.campaign.schema import parse

CAMPAIGN = {
    "campaign": 'name = "any"',
    "[test]": """kind = "sweep"
files = "sweep.h5"
channels = { input = "input", velocity = "velocity" }
units = { input = "V", velocity = "m/s" }""",
}
PUT = re.compile(r"Put under \[([\w.\[\]]+?)\]: `([^`]+)`")


def lines_of(action):
    """Return table and line of each campaign line that a remedy names."""
    return PUT.findall(action)


def pasted(action):
    """Return the campaign with a remedy's lines in it, as its schema reads them."""
    tables = dict(CAMPAIGN)
    for table, line in lines_of(action):
        tables[table] = f"{tables.get(table, '')}\n{line}".strip()
    return parse("\n".join(f"[{table}]\n{lines}" for table, lines in tables.items()))
