"""What is found without SciPy's searches is what they find, to the bit."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gf_usd.core import neighbors


def cloud(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 3)) * [1.0, 10.0, 0.1]


@pytest.mark.parametrize("n", [1, 2, 30, 500])  # the last is more than `FEW` pairs
@pytest.mark.parametrize("k", [1, 21])
def test_the_nearest_are_those_of_a_tree(n: int, k: int) -> None:
    points, at, k = cloud(n), cloud(500, seed=1), min(k, n)
    distance, index = neighbors.nearest(points, at, k)
    wanted = cKDTree(points).query(at, k=list(range(1, k + 1)))
    np.testing.assert_array_equal(distance, wanted[0])
    np.testing.assert_array_equal(index, wanted[1])


def test_a_point_is_the_nearest_to_itself() -> None:
    points = cloud(120)
    distance, index = neighbors.nearest(points, points, 3)
    np.testing.assert_array_equal(index[:, 0], np.arange(120))
    assert not distance[:, 0].any()


def test_squared_distances_are_those_of_scipy() -> None:
    a, b = cloud(70), cloud(90, seed=3)
    np.testing.assert_array_equal(neighbors.squared_distances(a, b), cdist(a, b, "sqeuclidean"))


def as_set(pairs: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(sorted(map(int, pair))) for pair in pairs}


@pytest.mark.parametrize("reach", [0.0, 1e-6, 0.3, 3.0])
@pytest.mark.parametrize("n", [1, 2, 9, 10, 300])
def test_pairs_within_reach_are_those_of_a_tree(n: int, reach: float) -> None:
    points = cloud(n)
    points[n // 2 :] = points[: n - n // 2] + 1e-7  # every second one has a twin
    wanted = cKDTree(points).query_pairs(reach, output_type="ndarray")
    assert as_set(neighbors.pairs_within(points, reach)) == as_set(wanted)


def test_a_wall_across_the_line_is_no_trap() -> None:
    """All places along the line are one: a tree has to find what a sweep would take n^2 for."""
    way = neighbors.WAY / np.linalg.norm(neighbors.WAY)
    flat = np.random.default_rng(0).normal(size=(2000, 3))
    flat -= (flat @ way)[:, None] * way
    flat[1000] = flat[3]
    assert as_set(neighbors.pairs_within(flat, 1e-9)) == {(3, 1000)}


@pytest.mark.parametrize("edges", [0, 5, 700, 9000])
@pytest.mark.parametrize("nodes", [1, 2000, 60_000])  # the last is more than `SMALL`
def test_parts_are_those_of_scipy_under_the_same_numbers(nodes: int, edges: int) -> None:
    a, b = np.random.default_rng(nodes + edges).integers(0, nodes, (2, edges))
    graph = coo_matrix((np.ones(edges), (a, b)), shape=(nodes, nodes))
    wanted = connected_components(graph, directed=False)
    parts, part = neighbors.components(graph)
    assert parts == wanted[0]
    np.testing.assert_array_equal(part, wanted[1])


@pytest.mark.slow
def test_the_tree_is_that_of_scipy_without_the_rest() -> None:
    code = (
        "import sys, numpy as np\n"
        "from gf_usd.core.neighbors import kd_tree\n"
        "tree = kd_tree(np.eye(3))\n"
        "print('scipy.spatial' in sys.modules, 'scipy.linalg' in sys.modules)\n"
        "from scipy.spatial import KDTree, cKDTree\n"
        "assert type(tree) is cKDTree and KDTree(np.eye(3)).query(np.ones(3))[1] == 0\n"
        "print(len(tree.query_pairs(1.5)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["False False", "3"]


@pytest.mark.slow
@pytest.mark.parametrize("switch", ["1", "0"])
def test_the_tree_is_imported_as_ever_where_there_are_threads_or_it_is_asked_for(
    switch: str,
) -> None:
    code = (
        "import os, sys, threading, numpy as np\n"
        "from gf_usd.core.neighbors import kd_tree\n"
        "end = threading.Event()\n"
        "if os.environ['GF_USD_FAST_START'] == '1': threading.Thread(target=end.wait).start()\n"
        "kd_tree(np.eye(3)); end.set()\n"
        "print('scipy.spatial' in sys.modules)\n"
    )
    environment = {**os.environ, "GF_USD_FAST_START": switch}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.strip() == "True"
