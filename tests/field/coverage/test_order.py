"""The order of visiting, against all orders tried one by one."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.field.coverage.order import VisitOrder, best_order

WORTH = 10_000.0


def random_costs(seed: int, count: int, broken: float) -> Float64:
    rng = np.random.default_rng(seed)
    costs = rng.uniform(1.0, 50.0, (2 * count + 1, 2 * count + 1))
    costs[rng.random(costs.shape) < broken] = math.inf
    costs[-1, -1] = 0.0
    return costs


def cost_of(nodes: tuple[int, ...], costs: Float64, worth: Float64) -> float:
    end = len(costs) - 1
    left = worth.sum() - sum(worth[node // 2] for node in nodes)
    return float(left + sum(costs[pair] for pair in itertools.pairwise((end, *nodes, end))))


def tried_all(costs: Float64, worth: Float64) -> float:
    """The least cost over all orders, directions and choices of things."""
    count = len(worth)
    best = float(worth.sum())
    for size in range(1, count + 1):
        for things in itertools.permutations(range(count), size):
            for ways in itertools.product((0, 1), repeat=size):
                nodes = tuple(2 * k + d for k, d in zip(things, ways, strict=True))
                best = min(best, cost_of(nodes, costs, worth))
    return best


def known_order(costs: Float64, worth: Float64) -> VisitOrder:
    return best_order(costs, np.ones(costs.shape, dtype=np.bool_), worth, lambda _: [])


@pytest.mark.parametrize("broken", [0.0, 0.5, 0.9])
def test_no_order_is_cheaper(broken: float) -> None:
    """Of up to four things."""
    for seed in range(12):
        count = 1 + seed % 4
        costs, worth = random_costs(seed, count, broken), WORTH * (1.0 + np.arange(count))
        order = known_order(costs, worth)
        assert order.cost == pytest.approx(tried_all(costs, worth))
        assert order.cost == pytest.approx(cost_of(tuple(order.nodes), costs, worth))
        assert len({node // 2 for node in order.nodes}) == len(order.nodes)


def test_costs_are_looked_up_only_where_they_matter() -> None:
    """With lower bounds the result is that of all costs, and most are never asked for."""
    true, worth = random_costs(3, 8, 0.1), np.full(8, WORTH)
    asked: set[tuple[int, int]] = set()

    def look_up(pairs: list[tuple[int, int]]) -> list[float]:
        assert not asked & set(pairs)
        asked.update(pairs)
        return [float(true[pair]) for pair in pairs]

    bounds, known = np.minimum(0.9 * true, 40.0), np.zeros(true.shape, dtype=np.bool_)
    order = best_order(bounds, known, worth, look_up)
    assert order.cost == pytest.approx(cost_of(tuple(order.nodes), true, worth))
    assert order.cost <= 1.1 * known_order(true, worth).cost
    assert len(asked) < 0.5 * true.size


def test_when_enough_costs_are_known_the_order_is_made_of_them() -> None:
    """Fewer are asked for, the order costs what it says, and nothing more is left out."""
    asked: dict[int | None, int] = {}
    for enough in (None, 12):
        true, worth = random_costs(3, 12, 0.1), np.full(12, WORTH)
        count = [0]

        def look_up(
            pairs: list[tuple[int, int]], true: Float64 = true, count: list[int] = count
        ) -> list[float]:
            count[0] += len(pairs)
            return [float(true[pair]) for pair in pairs]

        bounds, known = np.minimum(0.5 * true, 20.0), np.zeros(true.shape, dtype=np.bool_)
        order = best_order(bounds, known, worth, look_up, enough=enough)
        assert order.cost == pytest.approx(cost_of(tuple(order.nodes), true, worth))
        assert not order.left_out(12)
        asked[enough] = count[0]
    assert asked[12] < 0.7 * asked[None], asked
