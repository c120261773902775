"""The search for arrangements: where a few samples of a piece can be on its whole."""

from __future__ import annotations

import numpy as np

from unbend.jit import kernel


@kernel
def arrangements(
    differences, low, high, precision, clear, courses, between, their_courses, limits, strictness, turning, apart, alike
):
    """Return the places of k samples in each of up to `limits[0]` arrangements, (w, k), the best first.

    Samples are placed one after the other. Each arrangement is continued at its `limits[1]` best places, no two of them
    nearer than `apart`. Of all arrangements that differ by less than `alike` on average, the best one is kept, so that
    variants of one arrangement do not displace all others.
    """
    count, columns = differences.shape
    width = limits[0]
    states, costs = np.zeros((1, count), np.int64), np.zeros(1)
    values = np.empty(columns)
    for step in range(count):
        branches = columns if step == 0 else limits[1]
        room = len(states) * branches
        new_costs, parents, places = np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64)
        found = 0
        for state in range(len(states)):
            for column in range(columns):
                values[column] = differences[step, column] + _misfit(
                    states[state], step, column, low, high, precision, clear, courses, between, their_courses,
                    strictness, turning,
                )  # fmt: skip
            first = found
            for column in np.argsort(values):
                if not _any_near(places[first:found], between[column], apart):
                    new_costs[found], parents[found], places[found] = costs[state] + values[column], state, column
                    found += 1
                    if found - first == branches:
                        break
        following, following_costs, kept = np.zeros((width, count), np.int64), np.zeros(width), 0
        for index in np.argsort(new_costs[:found]):
            following[kept] = states[parents[index]]
            following[kept, step] = places[index]
            following_costs[kept] = new_costs[index]
            if not _is_known(following, kept, step + 1, between, alike):
                kept += 1
                if kept == width:
                    break
        states, costs = following[:kept], following_costs[:kept]
    return states


@kernel
def _misfit(state, step, column, low, high, precision, clear, courses, between, their_courses, strictness, turning):
    """Return what distances from, and directions away from, earlier samples cost at a place."""
    wrong, known, turned = 0.0, 0.0, 0j
    for earlier in range(step):
        distance = between[state[earlier], column]
        error = max(distance - high[step, earlier], low[step, earlier] - distance, 0.0) * precision[step, earlier]
        wrong += min(error * error, 1.0)
        weight = clear[step, earlier]
        known += weight
        turned += weight * their_courses[column, state[earlier]] * courses[step, earlier].conjugate()
    return strictness * wrong / max(step, 1) + turning * (known - abs(turned)) / (known + 1.0)


@kernel
def _any_near(places, row, apart):
    for place in places:  # noqa: SIM110 - Numba has no generators in any()
        if row[place] < apart:
            return True
    return False


@kernel
def _is_known(states, number, size, between, alike):
    """Return whether a state is like one before it."""
    for other in range(number):
        total = 0.0
        for sample in range(size):
            total += between[states[other, sample], states[number, sample]]
            if total >= alike * size:
                break
        if total < alike * size:
            return True
    return False
