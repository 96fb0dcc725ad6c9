"""Compiled start of an episode: random numbers, initial states, targets.

Each environment is one column of `state`; `signals.Signals.state` names the rows. The columns are
padded to whole blocks of lanes. Each environment has its own stream of random numbers, one entry of
`streams`.
"""

import math

import numpy as np

from dynamics.runtime.jit import on_disk

fast = on_disk(nogil=True, error_model="numpy")

# Indices are unsigned, because numba adds a check for negative indices to every signed one.
U = np.uint64
WAVES = 2  # sines in the path of a joint
STRAIGHT = -1.0  # control steps elapsed, where gravity has yet to bend the links of a new episode
# rows of `tasks.Task.ranges`, each (low, high)
START, MOVES, SHARE, TEMPO, SHAKE = map(U, range(5))
# entries of `at`, the first rows of a state
Q, V, CENTRE, AMPLITUDE, FREQUENCY, PHASE, FREE = map(U, range(7))


@fast
def uniform(streams, i, low, high):  # type: ignore[no-untyped-def]
    """Next number in [low, high) of the stream of environment i (splitmix64)."""
    state = np.uint64(streams[i]) + np.uint64(0x9E3779B97F4A7C15)
    streams[i] = np.int64(state)
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return low + (high - low) * (np.float64(z >> np.uint64(11)) * 2.0**-53)


@fast
def draw(streams, i, ranges, name):  # type: ignore[no-untyped-def]
    """Draw a number from one of a task's ranges."""
    return uniform(streams, i, ranges[name, 0], ranges[name, 1])


@fast
def either_sign(streams, i, ranges, name):  # type: ignore[no-untyped-def]
    """Draw a magnitude from one of a task's ranges, with a random sign."""
    sign = 1.0 if uniform(streams, i, 0.0, 1.0) < 0.5 else -1.0
    return sign * draw(streams, i, ranges, name)


@fast
def begin(  # type: ignore[no-untyped-def]
    rows, ranges, home, joints, base, amplitude, rate, most, free, at, state, streams,
):  # fmt: skip
    """Draw a new episode for the environments `rows`: state, reference, zero action.

    The reference is off the start by `ranges[MOVES]`, or moves along sines with `ranges[TEMPO]`;
    the natural modes vibrate with `ranges[SHAKE]`. Ranges with an upper end of zero are not drawn.

    `amplitude` and `rate` are the vibrations of `Scales`, a row per natural mode. `most` holds the
    largest angle [rad] and acceleration [rad/s^2] of a path, `base` the ranges of the pose of a
    floating base, `free` those of the arm's free parameters, `at` the first rows of the state in
    the order Q, V, CENTRE, ...
    """
    n_joint = U(joints.shape[0])
    for r in range(U(rows.shape[0])):
        i = U(rows[r])
        for k in range(at[FREE]):
            state[k, i] = 0.0
        for k in range(U(base.shape[0])):
            state[at[Q] + k, i] = draw(streams, i, base, k)
        for j in range(n_joint):
            centre = home[j] + draw(streams, i, ranges, START)
            state[at[Q] + joints[j], i] = centre
            if ranges[MOVES, 1] > 0.0:
                centre += either_sign(streams, i, ranges, MOVES)
            if ranges[TEMPO, 1] > 0.0:
                for k in range(U(WAVES)):
                    tempo = draw(streams, i, ranges, TEMPO)
                    share = draw(streams, i, ranges, SHARE)
                    wave = k * n_joint + j
                    state[at[AMPLITUDE] + wave, i] = min(share * most[1] / (tempo * tempo), most[0])
                    state[at[FREQUENCY] + wave, i] = tempo
                    state[at[PHASE] + wave, i] = uniform(streams, i, 0.0, 2.0 * math.pi)
            state[at[CENTRE] + j, i] = centre
        if ranges[SHAKE, 1] > 0.0:
            for w in range(U(amplitude.shape[0])):
                here = draw(streams, i, ranges, SHAKE)
                moving = draw(streams, i, ranges, SHAKE)
                mode = U(0)
                for k in range(at[V] - at[Q]):
                    joint = False
                    for j in range(n_joint):
                        joint = joint or joints[j] == k
                    if not joint:
                        state[at[Q] + k, i] += amplitude[w, mode] * here
                        state[at[V] + k, i] += rate[w, mode] * moving
                        mode += U(1)
        for k in range(U(free.shape[0])):
            state[at[FREE] + k, i] = draw(streams, i, free, k)
