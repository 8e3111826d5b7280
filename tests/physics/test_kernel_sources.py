"""What kernels must not contain, by their sources."""

import ast
from pathlib import Path

import pytest

import gf_usd.physics

FILES = sorted(Path(gf_usd.physics.__file__).parent.rglob("*.py"))


def static_choices(source: str) -> list[int]:
    """Lines with a conditional expression on `ti.static`."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.IfExp) and ast.unparse(node.test).startswith("ti.static(")
    ]


# Taichi builds both sides of a conditional expression, and then the chosen one again: a gather of
# nodal values in one of them ran twice, 7 % of a substep.
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_no_conditional_expression_is_on_a_static_value(path: Path) -> None:
    assert not static_choices(path.read_text())


def test_one_would_be_found() -> None:
    assert static_choices("x = 1\ny = f(x) if ti.static(a) else x\n") == [2]
