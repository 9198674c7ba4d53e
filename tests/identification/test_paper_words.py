"""The paper's steps are Bouc-Wen's, and say so where they are left out or another law acts."""

from types import SimpleNamespace

import pytest

from jbw.identification.paper_route import paper_words


@pytest.mark.parametrize(
    ("laws", "says"),
    [
        (("bouc_wen",), None),
        (("iwan4",), "omitted: the joint has iwan4."),
        (("masing_power", "cubic"), "omitted: the joint has masing_power and cubic."),
        ((), "omitted: the joint has none."),
        (("bouc_wen", "cubic"), "attribute the effect of cubic to it"),
    ],
)
def test_the_papers_steps_say_which_law_they_know(laws, says):
    seen = SimpleNamespace(linear=object(), probing=("a tone",), laws=laws)
    words = paper_words(seen)
    assert (words == ()) if says is None else (says in words[0] and "Bouc-Wen" in words[0])
    for absent in ({"linear": None}, {"probing": ()}):  # without tests for them there are none
        assert paper_words(SimpleNamespace(**{**vars(seen), **absent})) == ()
