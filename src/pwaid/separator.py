"""The narrowest separator near a given one: as many unknowns as there are paths across that have none in common.

A plane cuts a random mesh along a zigzag. Within a few steps of it a largest set of paths from one side to the other,
no two with a common unknown, leaves a smallest set of unknowns that blocks them all (Menger's theorem); paths are found
one after another, each may reroute those before it. `pwaid.dissection` keeps the result where that is a gain.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["narrow", "score"]

FREE, END = -1, -2  # on no path; where a path begins or ends


@numba.njit(cache=True)
def _augment(start, indptr, indices, band, last, before, after, entered, left, round_, came, stack):
    """One more path through the band from `start` that shares no unknown with others, which it may reroute; whether
    there is one. A state is twice an unknown, one more once it is left again."""
    entered[start] = round_
    came[2 * start] = -1
    stack[0] = 2 * start
    top = 1
    while top > 0:
        top -= 1
        state = stack[top]
        v = state >> 1
        if state & 1 == 0:
            u = v if before[v] == FREE else before[v]  # on a path: back along it
            if u >= 0 and left[u] != round_:
                left[u] = round_
                came[2 * u + 1] = state
                stack[top] = 2 * u + 1
                top += 1
            continue
        if last[v] and after[v] != END:
            _reroute(v, before, after, came)
            return True
        if before[v] != FREE and entered[v] != round_:
            entered[v] = round_
            came[2 * v] = state
            stack[top] = 2 * v
            top += 1
        for e in range(indptr[v], indptr[v + 1]):
            w = indices[e]
            if band[w] and w != after[v] and entered[w] != round_:
                entered[w] = round_
                came[2 * w] = state
                stack[top] = 2 * w
                top += 1
    return False


@numba.njit(cache=True)
def _reroute(v, before, after, came):
    """Change the paths by the one found, which ends in v."""
    after[v] = END
    state = 2 * v + 1
    while state >= 0:
        v, previous = state >> 1, came[state]
        if state & 1 == 0:
            if previous < 0:
                before[v] = END
            elif previous >> 1 == v:  # it leaves a path
                before[v], after[v] = FREE, FREE
            else:
                before[v], after[previous >> 1] = previous >> 1, v
        state = previous


@numba.njit(cache=True)
def narrow(indptr, indices, members, chosen, sizes, where, band, first, last, before, after, entered, left, round_,
           came, stack, width):
    """Move a separator to the narrowest place within `width` steps of it: as many unknowns as there are paths through
    that band without a common one (Menger). Changes `chosen` and `sizes` where that is a gain; returns the round."""
    for t in range(members.size):
        v = members[t]
        where[v] = chosen[t]
        band[v] = chosen[t] == 2
        before[v], after[v] = FREE, FREE
        first[v], last[v] = False, False
    head, tail = 0, 0
    for t in range(members.size):
        if band[members[t]]:
            stack[tail] = members[t]
            tail += 1
    for _ in range(width):
        end = tail
        while head < end:
            v = stack[head]
            head += 1
            for e in range(indptr[v], indptr[v + 1]):
                w = indices[e]
                if where[w] >= 0 and not band[w]:
                    band[w] = True
                    stack[tail] = w
                    tail += 1
    beyond = np.zeros(2, np.int64)
    for v in members:
        if not band[v]:
            beyond[where[v]] += 1
            for e in range(indptr[v], indptr[v + 1]):
                w = indices[e]
                if where[w] >= 0 and band[w]:
                    if where[v] == 0:
                        first[w] = True
                    else:
                        last[w] = True
    if min(beyond[0], beyond[1]) > 0:
        gained = True
        while gained:
            gained = False
            round_ += 1
            for v in members:
                if first[v]:
                    if before[v] == END:
                        entered[v] = round_
                    elif entered[v] != round_:
                        gained |= _augment(v, indptr, indices, band, last, before, after, entered, left, round_, came,
                                           stack)
        new = np.zeros(3, np.int64)
        for v in members:
            where[v] = _place(where[v], band[v], entered[v] == round_, left[v] == round_)
            new[where[v]] += 1
        if score(new) < score(sizes):
            sizes[:] = new
            for t in range(members.size):
                chosen[t] = where[members[t]]
    for v in members:
        where[v], band[v] = -1, False
    return round_


@numba.njit(cache=True)
def _place(where, in_band, entered, left):
    """The part of an unknown once paths are as many as can be: below is what they reach, between where they stop."""
    if not in_band:
        return where
    return 0 if left else (2 if entered else 1)


@numba.njit(cache=True)
def score(sizes):
    """The size of a separator for that of the smaller part."""
    return sizes[2] / max(1, min(sizes[0], sizes[1])) ** (1.0 / 3.0)
