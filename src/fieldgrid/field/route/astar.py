"""The inner loops of the search: see `field.route.search`. Positions are metres from the
window's south-west corner, yaws radians counter-clockwise from east."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import kernel, part_of_kernel
from fieldgrid.field.route.footprint import gap_m, may_lean

REVERSE_COST = 1.5
CUSP_M = 3.0
"""What a change of gear is worth in metres of way."""

X, Y, YAW, SPENT, ESTIMATE = range(5)
"""Columns of states: a pose, metres spent on the way there, and metres left by the estimate."""

PARENT, MOVE = range(2)
"""Columns of links: the state before, -1 for a start, and the move from there."""

QUEUED, COUNT, TRIES, NEAREST = range(4)
"""Places of counters."""

MOVES = 10
"""A move is a curvature of `CURVATURES`; five are forward, five in reverse."""

_HEADINGS = 48
_TURN_COST = 1.03
_GREED = 1.25
"""How much more the estimate counts than the way behind: routes may be longer by this, and are
found much sooner."""

_NEARER = 0.95
_EVERY = 40


@kernel
def step_is_free(  # type: ignore[no-untyped-def]
    x, y, yaw, hull, hulls, discs, clearance, blocked, to_blocked, cell
):
    """Whether what a step sweeps keeps its clearance; (x, y, yaw) is the pose behind it."""
    gap = gap_m(
        x, y, yaw, hulls[hull], discs[hull], clearance, clearance, blocked, to_blocked, cell
    )
    return gap >= clearance


@kernel
def first_free_word(  # type: ignore[no-untyped-def]
    turns, lengths, x, y, yaw, step, hulls, discs, clearance, blocked, to_blocked, cell, rises,
    limits, samples,
):  # fmt: skip
    """Fill `samples` [n, 5] with x, y, yaw, gear, curvature along the first free one of some words
    from a pose; how many, 0 when none is free.

    `turns` [w, 5] are curvatures, `lengths` [w, 5] signed metres, 0 where a word has ended. A pose
    where two segments meet is written once, but for a change of gear.
    """
    for w in range(len(turns)):
        px, py, angle, count = x, y, yaw, 0
        free = True
        for s in range(turns.shape[1]):
            curvature, size = turns[w, s], abs(lengths[w, s])
            if size < 1e-6 or not free:
                continue
            gear = 1.0 if lengths[w, s] > 0.0 else -1.0
            pieces = math.ceil(size / step - 1e-9)
            d = lengths[w, s] / pieces
            turn = curvature * d
            hull = 2
            if curvature != 0.0:
                hull = 4 if curvature > 0.0 else 0
            if count > 0 and samples[count - 1, 3] == gear:
                samples[count - 1, 4] = curvature
            elif count < len(samples):
                samples[count, 0], samples[count, 1], samples[count, 2] = px, py, angle
                samples[count, 3], samples[count, 4] = gear, curvature
                count += 1
            for _ in range(pieces):
                bx, by, back = px, py, angle
                if curvature == 0.0:
                    px, py = px + d * math.cos(angle), py + d * math.sin(angle)
                else:
                    px += (math.sin(angle + turn) - math.sin(angle)) / curvature
                    py += (math.cos(angle) - math.cos(angle + turn)) / curvature
                    angle += turn
                if gear < 0.0:
                    bx, by, back = px, py, angle
                free = count < len(samples) and may_lean(px, py, angle, cell, rises, limits)
                if not free or not step_is_free(
                    bx, by, back, hull, hulls, discs, clearance, blocked, to_blocked, cell
                ):
                    free = False
                    break
                samples[count, 0], samples[count, 1], samples[count, 2] = px, py, angle
                samples[count, 3], samples[count, 4] = gear, curvature
                count += 1
        if free:
            return count
    return 0


@part_of_kernel
def _push(heap, places, size, key, place):  # type: ignore[no-untyped-def]
    k = size
    while k > 0:
        parent = (k - 1) >> 1
        if heap[parent] <= key:
            break
        heap[k], places[k] = heap[parent], places[parent]
        k = parent
    heap[k], places[k] = key, place


@part_of_kernel
def _pop(heap, places, size):  # type: ignore[no-untyped-def]
    """The place with the smallest key; the heap then has one less."""
    top = places[0]
    key, place = heap[size - 1], places[size - 1]
    last = size - 1
    k = 0
    while True:
        child = 2 * k + 1
        if child >= last:
            break
        if child + 1 < last and heap[child + 1] < heap[child]:
            child += 1
        if heap[child] >= key:
            break
        heap[k], places[k] = heap[child], places[child]
        k = child
    heap[k], places[k] = key, place
    return top


@kernel
def spread(passable, j0, i0, size, through, left):  # type: ignore[no-untyped-def]
    """Dijkstra over eight neighbours from a cell: fill `left` with metres, inf beyond reach; a
    metre of what is not passable counts `through`, which may be inf."""
    height, width = passable.shape
    capacity = 8 * height * width + 8
    heap, places = np.empty(capacity, dtype=np.float32), np.empty(capacity, dtype=np.int64)
    left[j0, i0] = 0.0
    heap[0], places[0], count = 0.0, j0 * width + i0, 1
    while count > 0:
        key = heap[0]
        place = _pop(heap, places, count)
        count -= 1
        j, i = place // width, place % width
        if key > left[j, i]:
            continue
        for dj in range(-1, 2):
            for di in range(-1, 2):
                a, b = j + dj, i + di
                if a < 0 or b < 0 or a >= height or b >= width:
                    continue
                step = size * math.sqrt(dj * dj + di * di)
                if passable[a, b] == 0:
                    step *= through
                # Rounded before it is compared, so that a cell is queued once a neighbour at most.
                reached = np.float32(key + step)
                if reached < left[a, b]:
                    left[a, b] = reached
                    _push(heap, places, count, reached, a * width + b)
                    count += 1


@part_of_kernel
def _slot(table, key):  # type: ignore[no-untyped-def]
    """Where a key is in a table of open addresses, or where it would be put."""
    mask = len(table) - 1
    mixed = key ^ (key >> 15)
    mixed *= 0x2C1B3C6D
    mixed ^= mixed >> 12
    k = mixed & mask
    while table[k, 0] != -1 and table[k, 0] != key:
        k = (k + 1) & mask
    return k


@part_of_kernel
def _cell_of(x, y, yaw, move, lattice):  # type: ignore[no-untyped-def]
    """The number of the cell of the lattice that a move ends in."""
    share = (yaw % (2.0 * math.pi)) / (2.0 * math.pi)
    bearing = min(int(share * _HEADINGS), _HEADINGS - 1)
    # A change of gear costs, so the lattice tells the gears of one pose apart.
    return (int(x / lattice) * 1_000_003 + int(y / lattice)) * 256 + 2 * bearing + move // 5


@kernel
def expand(  # type: ignore[no-untyped-def]
    here, goal_x, goal_y, goal_yaws, radius, moves, move_m, arcs, lattice, left, left_cell, hulls,
    discs, clearance, blocked, to_blocked, cell, rises, limits, states, links, heap, places, table,
    counters, tried_at,
):  # fmt: skip
    """Make the moves from a state (-1 for none), and then from the best one of the queue, until a
    curve from a state to the goal is worth trying; that state, -1 when the queue is empty, -2 when
    there is no room for more.

    `moves` of the moves `arcs` [10, n, at least 3] may be made: poses along each from one at the
    corner that faces east. They are `move_m` long.
    """
    pieces = arcs.shape[1] - 1
    while True:
        if here < 0:
            if counters[QUEUED] == 0:
                return -1
            here = _pop(heap, places, counters[QUEUED])
            counters[QUEUED] -= 1
            if links[here, PARENT] >= 0:
                yaw, last = states[here, YAW], links[here, MOVE]
                key = _cell_of(states[here, X], states[here, Y], yaw, last, lattice)
                if table[_slot(table, key), 1] != here:
                    continue  # A cheaper way has reached the cell since, and is in the queue.
            counters[TRIES] += 1
            # Curves are costly: they are tried when the search has come nearer, and now and then.
            if links[here, PARENT] >= 0 and (
                states[here, ESTIMATE] < _NEARER * tried_at[0]
                or counters[TRIES] % (_EVERY * len(goal_yaws)) == 0
            ):
                tried_at[0] = min(tried_at[0], states[here, ESTIMATE])
                return here
        x, y, yaw = states[here, X], states[here, Y], states[here, YAW]
        cos, sin = math.cos(yaw), math.sin(yaw)
        before = links[here, MOVE]
        for m in range(moves):
            ahead, aside = arcs[m, pieces, 0], arcs[m, pieces, 1]
            qx, qy = x + ahead * cos - aside * sin, y + ahead * sin + aside * cos
            turned = yaw + arcs[m, pieces, 2]
            j, i = int(qy / left_cell), int(qx / left_cell)
            if qx < 0.0 or qy < 0.0 or j >= left.shape[0] or i >= left.shape[1]:
                continue
            rest = left[j, i]
            if not np.isfinite(rest):
                continue
            spent = states[here, SPENT] + move_m * (REVERSE_COST if m >= 5 else 1.0)
            if arcs[m, pieces, 2] != 0.0:
                spent += (_TURN_COST - 1.0) * move_m
            if before >= 0 and (before < 5) != (m < 5):
                spent += CUSP_M
            key = _cell_of(qx, qy, turned, m, lattice)
            slot = _slot(table, key)
            if table[slot, 0] == key and states[table[slot, 1], SPENT] <= spent + 1e-9:
                continue
            # What a step sweeps is looked up last, since it takes longest.
            free = True
            bx, by, back = x, y, yaw
            for k in range(1, pieces + 1):
                ahead, aside, angle = arcs[m, k, 0], arcs[m, k, 1], yaw + arcs[m, k, 2]
                px, py = x + ahead * cos - aside * sin, y + ahead * sin + aside * cos
                if m >= 5:  # The pose behind a step is the one after it in reverse.
                    bx, by, back = px, py, angle
                free = may_lean(px, py, angle, cell, rises, limits)
                if not free or not step_is_free(
                    bx, by, back, m % 5, hulls, discs, clearance, blocked, to_blocked, cell
                ):
                    free = False
                    break
                bx, by, back = px, py, angle
            if not free:
                continue
            count = counters[COUNT]
            if count >= len(states):
                return -2
            counters[COUNT] += 1
            table[slot, 0], table[slot, 1] = key, count
            links[count, PARENT], links[count, MOVE] = here, m
            if math.hypot(goal_x - qx, goal_y - qy) < 6.0 * radius:
                off = math.pi
                for k in range(len(goal_yaws)):
                    away = abs((goal_yaws[k] - turned + math.pi) % (2.0 * math.pi) - math.pi)
                    off = min(off, away)
                rest = max(rest, off * radius)
            states[count, X], states[count, Y], states[count, YAW] = qx, qy, turned
            states[count, SPENT], states[count, ESTIMATE] = spent, rest
            if rest < states[counters[NEAREST], ESTIMATE]:
                counters[NEAREST] = count
            _push(heap, places, counters[QUEUED], spent + _GREED * rest, count)
            counters[QUEUED] += 1
        here = np.int64(-1)
