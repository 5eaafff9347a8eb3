"""Random walks on a graph that is cut where few connections lead out of what they visit first."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

ENDS = 1e-5  # probability with which a walk ends at a step
SMALLEST = 0.02  # share of the connections that the smaller side of a cut has


def two_sided(graph: csr_array, rows: np.ndarray, seeds: np.ndarray, limit: float) -> np.ndarray:
    """The rows on the seeds' side of the weakest cut through some; all if none is weak."""
    order, boundary, sums = sweep(graph, rows, seeds, graph[rows][:, rows].sum(axis=1))
    smaller = np.minimum(sums, sums[-1] - sums)
    cost = boundary / np.sqrt(smaller.clip(1e-12))
    cost[(smaller < SMALLEST * sums[-1]) | (np.arange(len(rows)) < len(seeds) - 1)] = np.inf
    best = int(cost.argmin())
    return rows[order[: best + 1]] if cost[best] < limit else rows


def sweep(
    graph: csr_array, rows: np.ndarray, seeds: np.ndarray, sums: Float[np.ndarray, " R"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows ordered by visits, and for each the connections that it and those before have.

    Args:
        graph: Connections of all nodes.
        rows: The nodes to order.
        seeds: Those that walks start at.
        sums: The sum of the connections of each; walks end that take those to other nodes.

    Returns:
        The order, the connections that lead out, and all.
    """
    inside, seeded = graph[rows][:, rows], np.isin(rows, seeds)
    order = np.argsort(-visits(inside, seeded, sums) - seeded * 1e9, kind="stable")
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    pairs = inside.tocoo()
    inner = np.bincount(np.maximum(*(ranks[each] for each in pairs.coords)), pairs.data, len(rows))
    total = sums[order].cumsum()
    return order, total - inner.cumsum(), total


def nearer_to_seeds(
    graph: csr_array,
    rows: np.ndarray,
    seeds: np.ndarray,
    rivals: np.ndarray,
    sums: Float[np.ndarray, " R"],
) -> np.ndarray:
    """The rows that walks from the seeds visit more than those from the rivals; as in `sweep`."""
    inside = graph[rows][:, rows]
    mine, theirs = (visits(inside, np.isin(rows, each), sums) for each in (seeds, rivals))
    return rows[(mine > theirs) | np.isin(rows, seeds)]


def visits(
    graph: csr_array, seeded: Bool[np.ndarray, " R"], sums: Float[np.ndarray, " R"]
) -> Float[np.ndarray, " R"]:
    """Visits of walks from the seeds to each node, over the sum of its connections."""
    sums = sums.clip(1e-12)
    starts = seeded * sums / max((seeded * sums).sum(), 1e-12)
    return solve_symmetric(csr_array(diags_array(sums * (1 + ENDS)) - graph), starts)


def solve_symmetric(system: csr_array, right: Float[np.ndarray, " R"]) -> Float[np.ndarray, " R"]:
    """The solution of a sparse system that is symmetric and diagonally dominant."""
    options = {"SymmetricMode": True}
    factors = splu(system.tocsc(), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return factors.solve(right)
