"""Compiled loops around the stepper: what an environment does besides physics, for all of a batch.

Everything compiled sits in this one file, because numba's disk cache notices a change only in the
file of the function it caches. Per environment i:

| array          | shape           | holds                                                         |
|----------------|-----------------|---------------------------------------------------------------|
| memory         | (N, M)          | actions and the joint reference, see `*_OF` below [-], [rad]   |
| counters       | (N, 2) int64    | random stream, control steps since the start of the episode   |
| ref_q, ref_v   | (N, n)          | the joint reference now, links straight [rad], [rad/s]         |
| ref_measured   | (N, n_measure)  | what the stepper measures there: the target                   |

The reference of joint j is  centre + ramp(t) sum_k A_k sin(w_k t + p_k); A = 0 where it rests.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit, prange

fast = njit(cache=True, nogil=True, error_model="numpy")

# memory, in units of n_joint: action, action before, centre, amplitudes, frequencies, phases
WAVES = 2
ACTION, BEFORE, CENTRE, AMPLITUDE = 0, 1, 2, 3
FREQUENCY, PHASE, WIDTH = AMPLITUDE + WAVES, AMPLITUDE + 2 * WAVES, AMPLITUDE + 3 * WAVES

STREAM, ELAPSED = 0, 1  # counters

# constants: whole numbers
N_JOINT, N_COORDINATE, MOVING, LIMIT, N_CURVATURE = 0, 1, 2, 3, 4
TIP, TIP_VELOCITY, RIGID_TIP, DEFLECTION, SLOPE, JOINTS = 5, 6, 7, 8, 9, 10
# constants: real numbers
DT, REACH, DEFLECTION_LIMIT, SLOPE_LIMIT, SPEED, RATE, ANGLE, HORIZON, MOUNT = 0, 1, 2, 3, 4, 5, 6, 7, 8
WEIGHTS = MOUNT + 9

# rows of `info` and of `flags`
REWARD, TIME, TIP_ERROR, TIP_SPEED, MAX_DEFLECTION, TIP_DEFLECTION, FIRST_TERM = 0, 1, 2, 3, 4, 5, 6
TERMINATED, TRUNCATED, SETTLED, DIVERGED, INVALID, N_FLAG = 0, 1, 2, 3, 4, 5

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
    """Closeness of the tip to its target: 1 on it, 0.37 at 20 % of the reach."""
    return math.exp(-m.error / 0.2)


@fast
def precision(m):  # type: ignore[no-untyped-def]
    """Narrow closeness: 1 on the target, 0.37 at the edge of the settled band, 2 % of the reach."""
    return math.exp(-((m.error / 0.02) ** 2))


@fast
def stillness(m):  # type: ignore[no-untyped-def]
    """On the target and at rest: 1 there, 0.37 at 5 % of the reach or 10 % of a move's speed."""
    return math.exp(-((m.error / 0.05) ** 2) - (m.speed / 0.1) ** 2)


@fast
def distance(m):  # type: ignore[no-untyped-def]
    """Negative tip error over the reach."""
    return -m.error


@fast
def tip_speed(m):  # type: ignore[no-untyped-def]
    """Negative squared tip speed (of a typical move's), counted within 10 % of the reach."""
    return -math.exp(-((m.error / 0.1) ** 2)) * m.speed**2


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
N_TERM = len(TERMS)


@fast
def score(m, info, i):  # type: ignore[no-untyped-def]
    """All terms, in the order of TERMS, into the rows of `info` from FIRST_TERM on."""
    info[FIRST_TERM + 0, i] = tracking(m)
    info[FIRST_TERM + 1, i] = precision(m)
    info[FIRST_TERM + 2, i] = stillness(m)
    info[FIRST_TERM + 3, i] = distance(m)
    info[FIRST_TERM + 4, i] = tip_speed(m)
    info[FIRST_TERM + 5, i] = vibration(m)
    info[FIRST_TERM + 6, i] = effort(m)
    info[FIRST_TERM + 7, i] = smoothness(m)
    info[FIRST_TERM + 8, i] = joint_rate(m)
    info[FIRST_TERM + 9, i] = failure(m)


# ---- random numbers -------------------------------------------------------------------------------


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
def either_sign(counters, i, low, high):  # type: ignore[no-untyped-def]
    """A magnitude in [low, high) with a random sign."""
    sign = 1.0 if uniform(counters, i, 0.0, 1.0) < 0.5 else -1.0
    return sign * uniform(counters, i, low, high)


# ---- the reference --------------------------------------------------------------------------------


@fast
def waves(row, n_joint, j, t, ramp_time):  # type: ignore[no-untyped-def]
    """Angle [rad] and rate [rad/s] of joint j's motion about its centre at time t."""
    value, rate = 0.0, 0.0
    for k in range(WAVES):
        amplitude = row[(AMPLITUDE + k) * n_joint + j]
        frequency = row[(FREQUENCY + k) * n_joint + j]
        angle = frequency * t + row[(PHASE + k) * n_joint + j]
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
    n_joint = whole[N_JOINT]
    for i in range(actions.shape[0]):
        for j in range(n_joint):
            if math.isnan(actions[i, j]):
                return i
    for i in range(actions.shape[0]):
        row = memory[i]
        for j in range(n_joint):
            row[BEFORE * n_joint + j] = row[ACTION * n_joint + j]
            a = min(1.0, max(-1.0, np.float64(actions[i, j])))
            row[ACTION * n_joint + j] = a
            torque[i, j] = a * limit[j]
        counters[i, ELAPSED] += 1
        if whole[MOVING]:
            t = counters[i, ELAPSED] * real[DT]
            for j in range(n_joint):
                value, rate = waves(row, n_joint, j, t, real[HORIZON])
                ref_q[i, whole[JOINTS + j]] = row[CENTRE * n_joint + j] + value
                ref_v[i, whole[JOINTS + j]] = rate
    return -1


# ---- the start of an episode ----------------------------------------------------------------------

REACHING, TRACKING, DAMPING = 0, 1, 2  # tasks
# ranges of a task: rows of (low, high)
START, MOVES, SHARE, TEMPO, SHAKE = 0, 1, 2, 3, 4


@fast
def begin(rows, task, ranges, home, amplitude, rate, q, v, memory, counters, ref_q, ref_v, whole, real):  # type: ignore[no-untyped-def]
    """Draw a new episode for the environments `rows`: state, reference, zero action."""
    n_joint, n = whole[N_JOINT], whole[N_COORDINATE]
    for r in range(rows.shape[0]):
        i = rows[r]
        counters[i, ELAPSED] = 0
        memory[i, :] = 0.0
        q[i, :], v[i, :], ref_q[i, :], ref_v[i, :] = 0.0, 0.0, 0.0, 0.0
        for j in range(n_joint):
            at = whole[JOINTS + j]
            centre = home[j] + uniform(counters, i, ranges[START, 0], ranges[START, 1])
            q[i, at] = centre
            if task == REACHING:
                centre += either_sign(counters, i, ranges[MOVES, 0], ranges[MOVES, 1])
            elif task == TRACKING:
                for k in range(WAVES):
                    tempo = uniform(counters, i, ranges[TEMPO, 0], ranges[TEMPO, 1])
                    share = uniform(counters, i, ranges[SHARE, 0], ranges[SHARE, 1])
                    size = min(share * real[RATE] ** 2 / real[ANGLE] / tempo**2, real[ANGLE])
                    memory[i, (AMPLITUDE + k) * n_joint + j] = size
                    memory[i, (FREQUENCY + k) * n_joint + j] = tempo
                    memory[i, (PHASE + k) * n_joint + j] = uniform(counters, i, 0.0, 2.0 * math.pi)
            memory[i, CENTRE * n_joint + j] = centre
            ref_q[i, at] = centre
        if task == DAMPING:
            mode = 0
            for at in range(n):
                joint = False
                for j in range(n_joint):
                    joint = joint or whole[JOINTS + j] == at
                if not joint:
                    q[i, at] = amplitude[mode] * uniform(counters, i, ranges[SHAKE, 0], ranges[SHAKE, 1])
                    v[i, at] = rate[mode] * uniform(counters, i, ranges[SHAKE, 0], ranges[SHAKE, 1])
                    mode += 1


# ---- what an environment reports ------------------------------------------------------------------


@fast
def assess(i, fresh, q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured,
           whole, real, table, signals, obs, info, flags):  # type: ignore[no-untyped-def]  # fmt: skip
    """Measure, judge and observe environment i; `fresh` at the start of an episode."""
    n_joint, n, n_curvature = whole[N_JOINT], whole[N_COORDINATE], whole[N_CURVATURE]
    row, seen, goal = memory[i], measured[i], ref_measured[i]
    tip, velocity, rigid = whole[TIP], whole[TIP_VELOCITY], whole[RIGID_TIP]
    time = counters[i, ELAPSED] * real[DT]

    error, speed, bent = 0.0, 0.0, 0.0
    for k in range(3):
        error += (goal[tip + k] - seen[tip + k]) ** 2
        speed += (goal[velocity + k] - seen[velocity + k]) ** 2
        bent += (seen[tip + k] - seen[rigid + k]) ** 2
    error, speed, bent = math.sqrt(error), math.sqrt(speed), math.sqrt(bent)
    deflection, slope = 0.0, 0.0
    for j in range(n_joint):
        deflection = max(deflection, seen[whole[DEFLECTION] + j])
        slope = max(slope, seen[whole[SLOPE] + j])
    invalid = deflection > real[DEFLECTION_LIMIT] or slope > real[SLOPE_LIMIT]
    diverged = deflection > LOST * real[DEFLECTION_LIMIT] or (status[i] != 0 and not fresh)
    failed = (invalid or diverged) and not fresh
    late = counters[i, ELAPSED] >= whole[LIMIT] and whole[LIMIT] > 0

    rate, effort, change = 0.0, 0.0, 0.0
    for j in range(n_joint):
        rate += (v[i, whole[JOINTS + j]] / real[RATE]) ** 2
        effort += row[ACTION * n_joint + j] ** 2
        change += (row[ACTION * n_joint + j] - row[BEFORE * n_joint + j]) ** 2
    share = 1.0 / n_joint
    score(
        Measured(
            error / real[REACH], speed / real[SPEED], bent / (0.1 * real[REACH]),
            rate * share, effort * share, change * share, 1.0 if failed else 0.0,
        ),
        info, i,
    )  # fmt: skip
    reward = 0.0
    for k in range(N_TERM):
        reward += real[WEIGHTS + k] * info[FIRST_TERM + k, i]
    info[REWARD, i] = 0.0 if fresh else reward
    info[TIME, i] = time
    info[TIP_ERROR, i] = error
    info[TIP_SPEED, i] = speed
    info[MAX_DEFLECTION, i] = deflection
    info[TIP_DEFLECTION, i] = bent
    at = FIRST_TERM + N_TERM
    for k in range(n_curvature):
        info[at + k, i] = seen[whole[JOINTS + n_joint + k]]
    at += n_curvature
    for j in range(n_joint):
        info[at + j, i] = 0.0 if fresh else torque[i, j]
    flags[TERMINATED, i] = failed
    flags[TRUNCATED, i] = late and not failed and not fresh
    flags[SETTLED, i] = error < SETTLED_BAND * real[REACH]
    flags[DIVERGED, i] = diverged
    flags[INVALID, i] = invalid

    # every signal an observation may pick from, in the order of observations.SIGNALS
    s = 0
    for j in range(n_joint):
        signals[s + j] = q[i, whole[JOINTS + j]] - ref_q[i, whole[JOINTS + j]]
        signals[s + n_joint + j] = v[i, whole[JOINTS + j]]
        signals[s + 2 * n_joint + j] = row[ACTION * n_joint + j]
    s += 3 * n_joint
    cosine, sine = 1.0, 0.0
    for j in range(n_joint):
        angle = q[i, whole[JOINTS + j]]
        c, d = math.cos(angle), math.sin(angle)
        if j == 0:
            cosine, sine = c, d
        signals[s + j] = d
        signals[s + n_joint + j] = c
    s += 2 * n_joint
    for k in range(n):
        signals[s + k] = q[i, k]
        signals[s + n + k] = v[i, k]
    s += 2 * n
    for k in range(3):  # tip error along the first link's undeformed axes
        signals[s + k] = 0.0
        for l in range(3):
            signals[s + k] += real[MOUNT + 3 * l + k] * (goal[tip + l] - seen[tip + l])
    x, y = signals[s], signals[s + 1]
    signals[s] = cosine * x + sine * y
    signals[s + 1] = cosine * y - sine * x
    s += 3
    for k in range(n_curvature):
        signals[s + k] = seen[whole[JOINTS + n_joint + k]]
    s += n_curvature
    if whole[MOVING]:
        for j in range(n_joint):
            signals[s + j] = ref_v[i, whole[JOINTS + j]]
            for k in range(2):
                ahead = time + 0.5 * (k + 1) * real[HORIZON]
                value, _ = waves(row, n_joint, j, ahead, real[HORIZON])
                value += row[CENTRE * n_joint + j] - ref_q[i, whole[JOINTS + j]]
                signals[s + (k + 1) * n_joint + j] = value
    for k in range(table.shape[1]):
        x = signals[int(table[0, k])] * table[1, k]
        obs[i, k] = min(table[2, k], max(-table[2, k], x))
    return failed or (late and not fresh)


@fast
def judge(q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured, whole, real,
          table, n_signal, obs, info, flags):  # type: ignore[no-untyped-def]  # fmt: skip
    """Assess every environment after a control step; the number of ended episodes."""
    signals = np.empty(n_signal)
    ended = 0
    for i in range(q.shape[0]):
        ended += assess(
            i, False, q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured,
            whole, real, table, signals, obs, info, flags,
        )  # fmt: skip
    return ended


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def judge_parallel(q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured,
                   whole, real, table, n_signal, obs, info, flags):  # type: ignore[no-untyped-def]  # fmt: skip
    """The same with threads."""
    n_env = q.shape[0]
    blocks = (n_env + 255) // 256
    ended = 0
    for block in prange(blocks):
        signals = np.empty(n_signal)
        count = 0
        for i in range(256 * block, min(n_env, 256 * (block + 1))):
            count += assess(
                i, False, q, v, torque, status, measured, memory, counters, ref_q, ref_v,
                ref_measured, whole, real, table, signals, obs, info, flags,
            )  # fmt: skip
        ended += count
    return ended


@fast
def look(rows, q, v, torque, status, measured, memory, counters, ref_q, ref_v, ref_measured, whole,
         real, table, n_signal, obs, info, flags):  # type: ignore[no-untyped-def]  # fmt: skip
    """Assess the environments `rows` at the start of their episodes."""
    signals = np.empty(n_signal)
    for r in range(rows.shape[0]):
        assess(
            rows[r], True, q, v, torque, status, measured, memory, counters, ref_q, ref_v,
            ref_measured, whole, real, table, signals, obs, info, flags,
        )  # fmt: skip
