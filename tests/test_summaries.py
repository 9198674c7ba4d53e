"""The first line of a docstring stands alone: of a function with a verb, never as a fragment."""

import ast
from pathlib import Path

import pytest

import jbw

PACKAGE = Path(jbw.__file__).parent
# In the imperative. A verb that is missing here is added.
VERBS = frozenset(
    """
    accept add adjust advance align allocate amend answer append apply approximate ask
    assemble assert assign attach average begin bin bound bracket build cache calculate
    calibrate call centre change check choose claim classify clean clear clip close collapse
    collect combine compare compile complete compose compress compute condense condition
    configure confirm connect construct continue convert copy correct count cover create cut
    decide declare decode decompose default define delay delete demodulate derive describe
    detect determine differentiate discard display divide do draft draw drop encode end ensure
    enter enumerate estimate evaluate exclude execute exit expand explain export express
    extend extract extrapolate factor fail fill filter find finish fit flag flatten flip fold
    follow forget format gather generate get give group guess handle hold identify ignore
    import include increase index infer initialise initialize insert inspect instantiate
    integrate interpolate interrupt invert iterate join judge keep label launch leave limit
    linearise link list load locate lock log look make map march mark mask match maximise
    measure merge minimise mirror move multiply name normalise note number observe offer omit
    open order orthogonalise pack pad pair parse pass perform permute pick place plan plot
    pool predict prepare prescribe print process project propagate propose protect prove
    provide prune put quote raise rank read reconstruct record recover reduce refine reflect
    refuse register reject release remember remove rename reorder repeat replace report
    require resample rescale reset reshape resolve restore restrict resume return reuse
    reverse rewrite rotate round run sample save say scale scan score search select separate
    serialise set share shift shorten show shrink sign simplify simulate skip smooth solve
    sort split square stack start state step stop store stretch strip subtract suggest sum
    summarise supply suppress survey switch synthesise tabulate take tell test tighten time
    trace track train transform translate trim truncate try tune turn unpack unwrap update use
    validate verify visit wait walk warm warn watch weigh weight whiten widen window wrap
    write yield zero
    """.split()
)
# Words that lean on a line before them.
OPENINGS = (
    "Of ",
    "What ",
    "That ",
    "The same",
    "None ",
    "By ",
    "Whose ",
    "Where ",
    "Which ",
    "Beside ",
    "Nothing ",
    "Nobody ",
    "As ",
    "Behind ",
    "But ",
    "Nor ",
    "There ",
    "Those ",
    "Each's ",
    "All that ",
    "Either ",
)
NOUNS = {"property", "cached_property"}  # decorators of functions that are read as attributes


def summaries(path):
    """Yield place, kind and summary of every docstring of a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
            continue
        if docstring := ast.get_docstring(node):
            decorators = {ast.unparse(d) for d in getattr(node, "decorator_list", [])}
            is_noun = isinstance(node, ast.ClassDef | ast.Module) or bool(decorators & NOUNS)
            place = f"{path.relative_to(PACKAGE)}: {getattr(node, 'name', 'the module')}"
            yield place, is_noun, " ".join(docstring.split("\n\n")[0].split())


@pytest.fixture(scope="module")
def of_package():
    return [row for path in sorted(PACKAGE.rglob("*.py")) for row in summaries(path)]


def test_summaries_of_functions_begin_with_a_verb(of_package):
    others = [
        f"{place}: {text}"
        for place, is_noun, text in of_package
        # A figure's is the question that its report prints above it.
        if not (is_noun or text.endswith("?"))
        and text.split()[0].strip(".,:;`$\"'").lower() not in VERBS
    ]
    assert not others, "\n".join(others)


def test_no_summary_opens_with_a_fragment(of_package):
    fragments = [
        f"{place}: {text}"
        for place, _, text in of_package
        if text.startswith(OPENINGS) and not text.endswith("?")
    ]
    assert not fragments, "\n".join(fragments)
