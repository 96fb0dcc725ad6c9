"""Compiled loops of an environment: a control step of a batch, and the start of an episode.

All numbers of an environment are one column of `state`, its rows as `report.Report.state` names
them; the columns are filled up to whole blocks of lanes. An environment's own stream of random
numbers is one entry of `streams`.
"""

import math

import numpy as np
from numba import njit

fast = njit(cache=True, nogil=True, error_model="numpy")

# Indices are unsigned: numba would guard every signed one against counting from the end.
U = np.uint64
WAVES = 2  # sines in the path of a joint

# How a control step advances an arm behind ideal torque sources; drives.py knows actuators.
ADVANCE = """
@compiled
def advance(substeps, w):
    start(w, accelerations)
    for _ in range(substeps):
        step(w, accelerations)
"""

# What a generated module adds to its arm's `accelerations(w)`, its task's `check(w)` and
# `report(w)`, and one of the ADVANCE.
ENTRIES = """
TORQUE_LIMIT = CONSTANTS
take, put = lane_moves(int(LANES))


@compiled
def command(actions, column, w):
    last = np.uint64(actions.shape[0]) - np.uint64(1)
    for j in range(N_JOINT):
        at = j * LANES
        for b in range(LANES):
            a = w.dtype.type(actions[min(column + b, last), j])
            a = min(max(a, w.dtype.type(-1.0)), w.dtype.type(1.0))
            w[BEFORE + at + b] = w[ACTION + at + b]
            w[ACTION + at + b] = a
            w[TAU + at + b] = a * w[TORQUE_LIMIT + at + b]
    for b in range(LANES):
        w[ELAPSED + b] += w.dtype.type(1.0)


@compiled
def restore_lost(state, column, w):
    check(w)
    lost = False
    for b in range(LANES):
        lost |= w[CHECK + b] != w.dtype.type(0.0)
    for b in range(LANES):
        w[LOST + b] = 0.0
    if lost:
        for b in range(LANES):
            if w[CHECK + b] != w.dtype.type(0.0):
                w[LOST + b] = 1.0
                for k in range(np.uint64(2) * N_COORDINATE):
                    w[Q + k * LANES + b] = state[k, column + b]
                for k in range(N_ACTUATOR):
                    w[ACTUATOR + k * LANES + b] = state[FIRST_ACTUATOR + k, column + b]


@compiled
def step_lanes(actions, column, substeps, state, w):
    width = np.uint64(state.shape[1])
    n = np.uint64(2) * N_COORDINATE
    for k in range(n):
        take(w, Q + k * LANES, state, k * width + column)
    for k in range(N_MEMORY):
        take(w, ACTION + k * LANES, state, (n + k) * width + column)
    for k in range(N_FREE):
        take(w, PARAMETERS + k * LANES, state, (N_STATE + k) * width + column)
    command(actions, column, w)
    advance(substeps, w)
    restore_lost(state, column, w)
    report(w)
    for k in range(N_JOINT):
        put(w, TARGET_NOW + k * LANES, w, TARGET + k * LANES)
    for k in range(n):
        put(w, Q + k * LANES, state, k * width + column)
    for k in range(N_KEPT):
        put(w, ACTION + k * LANES, state, (n + k) * width + column)


@compiled
def not_numbers(actions):
    count = 0
    for i in range(np.uint64(actions.shape[0])):
        for j in range(N_JOINT):
            count += actions[i, j] != actions[i, j]
    return count


@outermost
def control_step(actions, first, stop, substeps, state, w, obs, info, flags):
    if not_numbers(actions) > 0:
        return np.int64(-1)
    first, stop = np.uint64(first), np.uint64(stop)
    width = np.uint64(state.shape[1])
    ended = np.int64(0)
    for block in range((stop - first + LANES - np.uint64(1)) // LANES):
        column = first + block * LANES
        step_lanes(actions, column, substeps, state, w)
        for k in range(N_FLAG):
            put(w, FLAGS + k * LANES, flags, k * width + column)
        for k in range(N_INFO):
            put(w, INFO + k * LANES, info, k * width + column)
        for b in range(min(LANES, stop - column)):
            for k in range(N_OBSERVATION):
                obs[column + b, k] = w[OBSERVATION + k * LANES + b]
            ended += flags[0, column + b] | flags[1, column + b]
    return ended


@outermost
def report_rows(rows, state, w, obs, info, flags):
    count = np.uint64(rows.shape[0])
    for block in range((count + LANES - np.uint64(1)) // LANES):
        first = block * LANES
        for b in range(LANES):
            i = np.uint64(rows[min(first + b, count - np.uint64(1))])
            for k in range(np.uint64(2) * N_COORDINATE):
                w[Q + k * LANES + b] = state[k, i]
            for k in range(N_MEMORY):
                w[ACTION + k * LANES + b] = state[np.uint64(2) * N_COORDINATE + k, i]
            for j in range(N_JOINT):
                w[BEFORE + j * LANES + b] = w[ACTION + j * LANES + b]
            w[LOST + b] = 0.0
        report(w)
        for b in range(min(LANES, count - first)):
            i = np.uint64(rows[first + b])
            for j in range(N_JOINT):
                target = np.uint64(2) * N_COORDINATE + N_JOINT + np.uint64(1) + j
                state[target, i] = w[TARGET_NOW + j * LANES + b]
            for k in range(N_FLAG):
                flags[k, i] = w[FLAGS + k * LANES + b] != w.dtype.type(0.0)
            for k in range(N_INFO):
                info[k, i] = w[INFO + k * LANES + b]
            for k in range(N_OBSERVATION):
                obs[i, k] = w[OBSERVATION + k * LANES + b]
"""


# ---- random numbers ------------------------------------------------------------------------------


@fast
def uniform(streams, i, low, high):  # type: ignore[no-untyped-def]
    """The next number in [low, high) of environment i's own stream (splitmix64)."""
    state = np.uint64(streams[i]) + np.uint64(0x9E3779B97F4A7C15)
    streams[i] = np.int64(state)
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return low + (high - low) * (np.float64(z >> np.uint64(11)) * 2.0**-53)


@fast
def draw(streams, i, ranges, name):  # type: ignore[no-untyped-def]
    """A number within one of a task's ranges."""
    return uniform(streams, i, ranges[name, 0], ranges[name, 1])


@fast
def either_sign(streams, i, ranges, name):  # type: ignore[no-untyped-def]
    """A magnitude within one of a task's ranges, with a random sign."""
    sign = 1.0 if uniform(streams, i, 0.0, 1.0) < 0.5 else -1.0
    return sign * draw(streams, i, ranges, name)


# ---- the start of an episode ---------------------------------------------------------------------

REACHING, TRACKING, DAMPING = 0, 1, 2  # tasks
# ranges of a task: rows of (low, high)
START, MOVES, SHARE, TEMPO, SHAKE = map(U, range(5))
# first rows of a state
Q, V, CENTRE, AMPLITUDE, FREQUENCY, PHASE, FREE = map(U, range(7))


@fast
def begin(  # type: ignore[no-untyped-def]
    rows, task, ranges, home, joints, amplitude, rate, most, free, at, state, streams,
):  # fmt: skip
    """Draw a new episode for the environments `rows`: state, reference, zero action.

    `most` holds the largest angle [rad] and acceleration [rad/s^2] of a path, `free` the ranges of
    the arm's free parameters, `at` the first rows of the state by the names above.
    """
    n_joint = U(joints.shape[0])
    for r in range(U(rows.shape[0])):
        i = U(rows[r])
        for k in range(at[FREE]):
            state[k, i] = 0.0
        for j in range(n_joint):
            centre = home[j] + draw(streams, i, ranges, START)
            state[at[Q] + joints[j], i] = centre
            if task == REACHING:
                centre += either_sign(streams, i, ranges, MOVES)
            elif task == TRACKING:
                for k in range(U(WAVES)):
                    tempo = draw(streams, i, ranges, TEMPO)
                    share = draw(streams, i, ranges, SHARE)
                    wave = k * n_joint + j
                    state[at[AMPLITUDE] + wave, i] = min(share * most[1] / tempo**2, most[0])
                    state[at[FREQUENCY] + wave, i] = tempo
                    state[at[PHASE] + wave, i] = uniform(streams, i, 0.0, 2.0 * math.pi)
            state[at[CENTRE] + j, i] = centre
        if task == DAMPING:
            mode = U(0)
            for k in range(at[V] - at[Q]):
                joint = False
                for j in range(n_joint):
                    joint = joint or joints[j] == k
                if not joint:
                    state[at[Q] + k, i] = amplitude[mode] * draw(streams, i, ranges, SHAKE)
                    state[at[V] + k, i] = rate[mode] * draw(streams, i, ranges, SHAKE)
                    mode += U(1)
        for k in range(U(free.shape[0])):
            state[at[FREE] + k, i] = draw(streams, i, free, k)
