"""Compiled loops of an environment: a control step of a batch, and the start of an episode.

All numbers of an environment are one column of `state`, its rows as `report.Report.state` names
them; the columns are filled up to whole blocks of lanes. An environment's own stream of random
numbers is one entry of `streams`.
"""

import math

import numpy as np

from dynamics.runtime.jit import on_disk

fast = on_disk(nogil=True, error_model="numpy")

# Indices are unsigned: numba would guard every signed one against counting from the end.
U = np.uint64
WAVES = 2  # sines in the path of a joint

# What a generated module adds to its arm's `accelerations(w)` and its task's `command(w)`,
# `check(w)` and `report(w)`: one entry, because `report` takes long to compile. It takes turns at
# `rows`, steps those environments, and says how many ended, or that an action of theirs is not
# finite; without substeps it reports on all `rows`. An environment that is lost goes back to its
# last state, and is reported there. #advance stands for what steps the arm.
ENTRIES = """
take, put, expect = lane_moves(int(LANES))
gather, scatter = row_moves(int(LANES))


@outermost
def control_step(rows, thread, substeps, dt, actions, state, w, obs, info, flags):
    width = np.uint64(state.shape[1])
    if substeps == 0:
        count = np.uint64(rows.shape[0])
        for block in range((count + LANES - np.uint64(1)) // LANES):
            first = block * LANES
            for b in range(LANES):
                i = np.uint64(rows[min(first + b, count - np.uint64(1))])
                for k in range(N_STATE):
                    w[Q + k * LANES + b] = state[k, i]
                for k in range(N_MEMORY):
                    w[ACTION + k * LANES + b] = state[N_STATE + k, i]
                for j in range(N_JOINT):
                    w[BEFORE + j * LANES + b] = w[ACTION + j * LANES + b]
                w[LOST + b] = 0.0
            report(w)
            check(w)
            report(w)
            for b in range(min(LANES, count - first)):
                i = np.uint64(rows[first + b])
                for j in range(N_JOINT):
                    state[FIRST_TARGET + j, i] = w[TARGET_NOW + j * LANES + b]
                for k in range(N_FLAG):
                    flags[k, i] = w[FLAGS + k * LANES + b] != 0.0
                for k in range(N_INFO):
                    info[k, i] = w[INFO + k * LANES + b]
                scatter(w, OBSERVATION + b, obs, i)
        return np.int64(0)

    ended = np.int64(0)
    #steps
    start, stop = first_turn(rows, thread)
    while start < stop:
        for i in range(start, stop):
            for j in range(N_JOINT):
                ended -= actions[i, j] - actions[i, j] != 0.0
        if ended < 0:
            return ended
        for column in range(start, stop, LANES):
            if column + LANES < stop:
                for k in range(N_STATE + N_MEMORY):
                    expect(state, k * width + column + LANES)
                for k in range(N_INFO):
                    expect(info, k * width + column + LANES)
            for k in range(N_STATE):
                take(w, Q + k * LANES, state, k * width + column)
            for k in range(N_MEMORY):
                take(w, ACTION + k * LANES, state, (N_STATE + k) * width + column)
            for k in range(N_FREE):
                take(w, PARAMETERS + k * LANES, state, (N_STATE + N_MEMORY + k) * width + column)
            gather(w, GIVEN, actions, column)
            command(w)
            #advance
            report(w)
            check(w)
            again = False
            for b in range(LANES):
                if w[LOST + b] > 0.0:
                    again = True
                    for k in range(N_STATE):
                        w[Q + k * LANES + b] = state[k, column + b]
                    for k in range(N_ACTUATOR):
                        w[ACTUATOR + k * LANES + b] = state[FIRST_ACTUATOR + k, column + b]
            if again:
                report(w)
            for k in range(N_JOINT):
                put(w, TARGET_NOW + k * LANES, w, TARGET + k * LANES)
            for k in range(N_STATE):
                put(w, Q + k * LANES, state, k * width + column)
            for k in range(N_KEPT):
                put(w, ACTION + k * LANES, state, (N_STATE + k) * width + column)
            for k in range(N_FLAG):
                put(w, FLAGS + k * LANES, flags, k * width + column)
            for k in range(N_INFO):
                put(w, INFO + k * LANES, info, k * width + column)
            for b in range(min(LANES, stop - column)):
                for k in range(N_OBSERVATION):
                    obs[column + b, k] = w[OBSERVATION + k * LANES + b]
                ended += flags[0, column + b] | flags[1, column + b]
        start, stop = take_turn(rows, thread)
    return ended
"""

# how a control step advances an arm behind ideal torque sources; drives.py knows actuators
IDEAL = {"#advance": ["#start", "for _ in range(substeps):", "    #step"]}


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
