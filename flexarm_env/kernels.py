"""Compiled loops around the stepper: what an environment does besides physics, for all of a batch.

Everything compiled sits in this one file, because numba's disk cache notices a change only in the
file of the function it caches. Per environment i:

| array          | shape           | holds                                                         |
|----------------|-----------------|---------------------------------------------------------------|
| memory         | (N, M)          | actions and the joint reference, see the indices below        |
| counters       | (N, 2) int64    | random stream, control steps since the start of the episode   |
| ref_q, ref_v   | (N, n)          | the joint reference now, links straight [rad], [rad/s]        |
| ref_measured   | (N, n_measure)  | what the stepper measures there: the target                   |

The reference of joint j is  centre + ramp(t) sum_k A_k sin(w_k t + p_k); A = 0 where it rests.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

fast = njit(cache=True, nogil=True, error_model="numpy")

# Indices are unsigned: numba would guard every signed one against counting from the end.
U = np.uint64
NONE, TWO, THREE, WAVES = U(0), U(2), U(3), U(2)
# memory, in units of n_joint: action, action before, centre, amplitudes, frequencies, phases
ACTION, BEFORE, CENTRE, AMPLITUDE, FREQUENCY, PHASE, WIDTH = map(U, (0, 1, 2, 3, 5, 7, 9))
# counters
STREAM, ELAPSED = U(0), U(1)
# whole: sizes, then columns of `measured`, then coordinates of the joints, then strain gauges
N_JOINT, N_COORDINATE, MOVING, LIMIT, N_CURVATURE = map(U, range(5))
TIP, TIP_VELOCITY, RIGID_TIP, DEFLECTION, SLOPE, JOINTS = map(U, range(5, 11))
# real: then the mounting of the first joint (3 x 3), then the weights of the terms
DT, REACH, DEFLECTION_LIMIT, SLOPE_LIMIT, SPEED, RATE, ANGLE, HORIZON, MOUNT = map(U, range(9))
WEIGHTS = U(17)
# columns of `info` and of `flags`
REWARD, TIME, TIP_ERROR, TIP_SPEED, MAX_DEFLECTION, TIP_DEFLECTION, FIRST_TERM = map(U, range(7))
TERMINATED, TRUNCATED, SETTLED, DIVERGED, INVALID, N_FLAG = map(U, range(6))
# ranges of a task: columns
LOW, HIGH = U(0), U(1)
# table: rows
FACTOR, BOUND = U(0), U(1)

SETTLED_BAND = 0.02  # [-] tip error over reach
LOST = 3.0  # [-] times the deflection limit: finite, but no longer a motion of this arm

Measured = namedtuple(
    "Measured", ["error", "speed", "vibration", "rate", "effort", "change", "failed"]
)
Measured.__doc__ = """What a reward term sees, all dimensionless.

error: tip error over reach. speed: tip speed relative to the target's, over that of a typical move.
vibration: elastic tip displacement over 10 % of the reach. rate, effort, change: mean squares over
the joints of rate (over that of a typical move), action and change of action. failed: 1 or 0.
"""


# ---- reward terms: goals in [0, 1], costs at most 0 ----------------------------------------------


@fast
def tracking(m):  # type: ignore[no-untyped-def]
    """Closeness of the tip to its target: 1 on it, 1/2 at 10 % of the reach."""
    return 1.0 / (1.0 + 10.0 * m.error)


@fast
def precision(m):  # type: ignore[no-untyped-def]
    """Narrow closeness: 1 on the target, 1/2 at the edge of the settled band, 2 % of the reach."""
    return 1.0 / (1.0 + (50.0 * m.error) ** 2)


@fast
def stillness(m):  # type: ignore[no-untyped-def]
    """On the target and at rest: 1 there, 1/2 at 5 % of the reach or 10 % of a move's speed."""
    return 1.0 / (1.0 + (20.0 * m.error) ** 2 + (10.0 * m.speed) ** 2)


@fast
def distance(m):  # type: ignore[no-untyped-def]
    """Negative tip error over the reach."""
    return -m.error


@fast
def tip_speed(m):  # type: ignore[no-untyped-def]
    """Negative squared tip speed (of a typical move's), halved at 10 % of the reach off target."""
    return -(m.speed**2) / (1.0 + (10.0 * m.error) ** 2)


@fast
def vibration(m):  # type: ignore[no-untyped-def]
    """Negative squared elastic tip displacement (of 10 % of the reach)."""
    return -(m.vibration**2)


@fast
def effort(m):  # type: ignore[no-untyped-def]
    """Negative mean square of the actions."""
    return -m.effort


@fast
def smoothness(m):  # type: ignore[no-untyped-def]
    """Negative mean square of the change of the actions."""
    return -m.change


@fast
def joint_rate(m):  # type: ignore[no-untyped-def]
    """Negative mean square of the joint rates (of a typical move's)."""
    return -m.rate


@fast
def failure(m):  # type: ignore[no-untyped-def]
    """-1 at the step that ends an episode by failure."""
    return -m.failed


TERMS = {
    term.__name__: term
    for term in (
        tracking, precision, stillness, distance, tip_speed, vibration, effort, smoothness,
        joint_rate, failure,
    )
}  # fmt: skip
N_TERM = U(len(TERMS))


@fast
def score(m):  # type: ignore[no-untyped-def]
    """All terms in the order of TERMS."""
    return (
        tracking(m), precision(m), stillness(m), distance(m), tip_speed(m), vibration(m), effort(m),
        smoothness(m), joint_rate(m), failure(m),
    )  # fmt: skip


# ---- random numbers ------------------------------------------------------------------------------


@fast
def uniform(counters, i, low, high):  # type: ignore[no-untyped-def]
    """The next number in [low, high) of environment i's own stream (splitmix64)."""
    state = np.uint64(counters[i, STREAM]) + np.uint64(0x9E3779B97F4A7C15)
    counters[i, STREAM] = np.int64(state)
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return low + (high - low) * (np.float64(z >> np.uint64(11)) * 2.0**-53)


@fast
def draw(counters, i, ranges, name):  # type: ignore[no-untyped-def]
    """A number within one of a task's ranges."""
    return uniform(counters, i, ranges[name, LOW], ranges[name, HIGH])


@fast
def either_sign(counters, i, ranges, name):  # type: ignore[no-untyped-def]
    """A magnitude within one of a task's ranges, with a random sign."""
    sign = 1.0 if uniform(counters, i, 0.0, 1.0) < 0.5 else -1.0
    return sign * draw(counters, i, ranges, name)


# ---- the reference -------------------------------------------------------------------------------


@fast
def waves(memory, i, n_joint, j, t, ramp_time):  # type: ignore[no-untyped-def]
    """Angle [rad] and rate [rad/s] of joint j's motion about its centre at time t."""
    value, rate = 0.0, 0.0
    for k in range(WAVES):
        amplitude = memory[i, (AMPLITUDE + k) * n_joint + j]
        frequency = memory[i, (FREQUENCY + k) * n_joint + j]
        angle = frequency * t + memory[i, (PHASE + k) * n_joint + j]
        value += amplitude * math.sin(angle)
        rate += amplitude * frequency * math.cos(angle)
    x = t / ramp_time
    if x < 1.0:  # smooth to the second derivative, at rest at t = 0
        ramp = x * x * x * (10.0 + x * (6.0 * x - 15.0))
        rate = ramp * rate + 30.0 * x * x * (1.0 - x) * (1.0 - x) / ramp_time * value
        value *= ramp
    return value, rate


@fast
def command(actions, limit, torque, memory, counters, ref_q, ref_v, whole, real):  # type: ignore[no-untyped-def]
    """Clipped actions to torques, time to the end of the coming step, the reference to that time.

    Returns -1, or the first environment whose action is not a number; then nothing has changed.
    """
    n_env, n_joint = U(actions.shape[0]), whole[N_JOINT]
    for i in range(n_env):
        for j in range(n_joint):
            if math.isnan(actions[i, j]):
                return np.int64(i)
    for i in range(n_env):
        counters[i, ELAPSED] += 1
        t = counters[i, ELAPSED] * real[DT]
        for j in range(n_joint):
            memory[i, BEFORE * n_joint + j] = memory[i, ACTION * n_joint + j]
            a = min(1.0, max(-1.0, np.float64(actions[i, j])))
            memory[i, ACTION * n_joint + j] = a
            torque[i, j] = a * limit[j]
            if whole[MOVING]:
                value, rate = waves(memory, i, n_joint, j, t, real[HORIZON])
                ref_q[i, whole[JOINTS + j]] = memory[i, CENTRE * n_joint + j] + value
                ref_v[i, whole[JOINTS + j]] = rate
    return np.int64(-1)


# ---- the start of an episode ---------------------------------------------------------------------

REACHING, TRACKING, DAMPING = 0, 1, 2  # tasks
# ranges of a task: rows of (low, high)
START, MOVES, SHARE, TEMPO, SHAKE = map(U, range(5))


@fast
def begin(  # type: ignore[no-untyped-def]
    rows, task, ranges, home, amplitude, rate, q, v, memory, counters, ref_q, ref_v, whole, real,
):  # fmt: skip
    """Draw a new episode for the environments `rows`: state, reference, zero action."""
    n_joint, n = whole[N_JOINT], whole[N_COORDINATE]
    for r in range(U(rows.shape[0])):
        i = U(rows[r])
        counters[i, ELAPSED] = 0
        memory[i, :] = 0.0
        q[i, :], v[i, :], ref_q[i, :], ref_v[i, :] = 0.0, 0.0, 0.0, 0.0
        for j in range(n_joint):
            at = whole[JOINTS + j]
            centre = home[j] + draw(counters, i, ranges, START)
            q[i, at] = centre
            if task == REACHING:
                centre += either_sign(counters, i, ranges, MOVES)
            elif task == TRACKING:
                for k in range(WAVES):
                    tempo = draw(counters, i, ranges, TEMPO)
                    share = draw(counters, i, ranges, SHARE)
                    size = min(share * real[RATE] ** 2 / real[ANGLE] / tempo**2, real[ANGLE])
                    memory[i, (AMPLITUDE + k) * n_joint + j] = size
                    memory[i, (FREQUENCY + k) * n_joint + j] = tempo
                    memory[i, (PHASE + k) * n_joint + j] = uniform(counters, i, 0.0, 2.0 * math.pi)
            memory[i, CENTRE * n_joint + j] = centre
            ref_q[i, at] = centre
        if task == DAMPING:
            mode = U(0)
            for at in range(n):
                joint = False
                for j in range(n_joint):
                    joint = joint or whole[JOINTS + j] == at
                if not joint:
                    q[i, at] = amplitude[mode] * draw(counters, i, ranges, SHAKE)
                    v[i, at] = rate[mode] * draw(counters, i, ranges, SHAKE)
                    mode += U(1)


# ---- what an environment reports -----------------------------------------------------------------


@fast
def judge(  # type: ignore[no-untyped-def]
    rows, fresh, q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured,
    whole, real, picks, table, n_signal, obs, info, flags,
):  # fmt: skip
    """Measure, judge and observe the environments `rows`; the number of episodes that ended.

    After a control step, or `fresh` at the start of an episode. One long function on purpose: every
    array handed to another one costs two atomic counts per environment.
    """
    n_joint, n, n_curvature = whole[N_JOINT], whole[N_COORDINATE], whole[N_CURVATURE]
    tip, velocity, rigid = whole[TIP], whole[TIP_VELOCITY], whole[RIGID_TIP]
    signals = np.empty(n_signal)
    ended = 0
    for r in range(U(rows.shape[0])):
        i = U(rows[r])
        time = counters[i, ELAPSED] * real[DT]

        error, speed, bent = 0.0, 0.0, 0.0
        for k in range(THREE):
            error += (ref_measured[i, tip + k] - measured[i, tip + k]) ** 2
            speed += (ref_measured[i, velocity + k] - measured[i, velocity + k]) ** 2
            bent += (measured[i, tip + k] - measured[i, rigid + k]) ** 2
        error, speed, bent = math.sqrt(error), math.sqrt(speed), math.sqrt(bent)
        deflection, slope = 0.0, 0.0
        for j in range(n_joint):
            deflection = max(deflection, measured[i, whole[DEFLECTION] + j])
            slope = max(slope, measured[i, whole[SLOPE] + j])
        invalid = deflection > real[DEFLECTION_LIMIT] or slope > real[SLOPE_LIMIT]
        diverged = deflection > LOST * real[DEFLECTION_LIMIT] or (status[i] != 0 and not fresh)
        failed = (invalid or diverged) and not fresh
        late = whole[LIMIT] > NONE and U(counters[i, ELAPSED]) >= whole[LIMIT]

        rate, effort, change = 0.0, 0.0, 0.0
        for j in range(n_joint):
            rate += (v[i, whole[JOINTS + j]] / real[RATE]) ** 2
            effort += memory[i, ACTION * n_joint + j] ** 2
            change += (memory[i, ACTION * n_joint + j] - memory[i, BEFORE * n_joint + j]) ** 2
        share = 1.0 / np.float64(n_joint)
        terms = score(
            Measured(
                error / real[REACH], speed / real[SPEED], bent / (0.1 * real[REACH]),
                rate * share, effort * share, change * share, 1.0 if failed else 0.0,
            )
        )  # fmt: skip
        reward = 0.0
        for k in range(N_TERM):
            info[i, FIRST_TERM + k] = terms[k]
            reward += real[WEIGHTS + k] * terms[k]
        info[i, REWARD] = 0.0 if fresh else reward
        info[i, TIME] = time
        info[i, TIP_ERROR] = error
        info[i, TIP_SPEED] = speed
        info[i, MAX_DEFLECTION] = deflection
        info[i, TIP_DEFLECTION] = bent
        at = FIRST_TERM + N_TERM
        for k in range(n_curvature):
            info[i, at + k] = measured[i, whole[JOINTS + n_joint + k]]
        at += n_curvature
        for j in range(n_joint):
            info[i, at + j] = 0.0 if fresh else torque[i, j]
        flags[i, TERMINATED] = failed
        flags[i, TRUNCATED] = late and not fresh
        flags[i, SETTLED] = error < SETTLED_BAND * real[REACH]
        flags[i, DIVERGED] = diverged
        flags[i, INVALID] = invalid

        # every signal an observation may pick from, in the order of observations.py
        s = U(0)
        for j in range(n_joint):
            signals[s + j] = q[i, whole[JOINTS + j]] - ref_q[i, whole[JOINTS + j]]
            signals[s + n_joint + j] = v[i, whole[JOINTS + j]]
            signals[s + TWO * n_joint + j] = memory[i, ACTION * n_joint + j]
        s += THREE * n_joint
        cosine, sine = 1.0, 0.0
        for j in range(n_joint):
            angle = q[i, whole[JOINTS + j]]
            c, d = math.cos(angle), math.sin(angle)
            if j == NONE:
                cosine, sine = c, d
            signals[s + j] = d
            signals[s + n_joint + j] = c
        s += TWO * n_joint
        for k in range(n):
            signals[s + k] = q[i, k]
            signals[s + n + k] = v[i, k]
        s += TWO * n
        for k in range(THREE):  # tip error along the first link's undeformed axes
            signals[s + k] = 0.0
            for l in range(THREE):
                signals[s + k] += real[MOUNT + THREE * l + k] * (
                    ref_measured[i, tip + l] - measured[i, tip + l]
                )
        x, y = signals[s], signals[s + U(1)]
        signals[s] = cosine * x + sine * y
        signals[s + U(1)] = cosine * y - sine * x
        s += THREE
        for k in range(n_curvature):
            signals[s + k] = measured[i, whole[JOINTS + n_joint + k]]
        s += n_curvature
        if whole[MOVING]:
            for j in range(n_joint):
                signals[s + j] = ref_v[i, whole[JOINTS + j]]
                for k in range(TWO):
                    ahead = time + 0.5 * np.float64(k + U(1)) * real[HORIZON]
                    value, _ = waves(memory, i, n_joint, j, ahead, real[HORIZON])
                    value += memory[i, CENTRE * n_joint + j] - ref_q[i, whole[JOINTS + j]]
                    signals[s + (k + U(1)) * n_joint + j] = value
        for k in range(U(table.shape[1])):
            x = signals[picks[k]] * table[FACTOR, k]
            obs[i, k] = min(table[BOUND, k], max(-table[BOUND, k], x))
        ended += failed or (late and not fresh)
    return ended
