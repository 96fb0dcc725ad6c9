"""Template of an environment's entry point: one control step of a batch.

The template is text because it becomes part of a generated module, whose functions it calls: the
arm's `accelerations(w)`, the task's `command(w)`, `check(w)` and `report(w)`, and the parts of the
integrator. Lines that begin with # are marks and are replaced: #steps, #start and #step by the
integrator, #advance by `IDEAL` or `actuation.DRIVEN`, #sensors and #noise by `EXACT` or
`sensing.NOISY`, #parameters, #place and #placed by `FLOATING` or `STANDING`.
`python -m dynamics source ARM --env ID` prints the module.

`control_step` is the only entry point because `report` takes long to compile. It steps the
environments of its chunks and returns the number of ended episodes. A negative number means that
actions of the first chunk are not finite; then nothing is stepped. With `substeps` 0 it only
reports on the environments that `rows` lists. An environment that `check` finds lost returns to its
state before the step and is reported there.
"""

ENTRIES = """
take, put, expect = lane_moves(int(LANES))
_, scatter = row_moves(int(LANES))
take_actions, _ = block_moves(int(LANES), int(N_ACTION))
_, put_observations = block_moves(int(LANES), int(N_OBSERVATION))


#sensors
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
                for k in range(N_DRAWN):
                    w[DRAWN + k * LANES + b] = state[N_STATE + N_MEMORY + N_FREE + k, i]
                for j in range(N_ACTION):
                    w[BEFORE + j * LANES + b] = w[ACTION + j * LANES + b]
                w[LOST + b] = 0.0
                #parameters
            #place
            #noise
            report(w)
            check(w)
            report(w)
            for b in range(min(LANES, count - first)):
                i = np.uint64(rows[first + b])
                for j in range(N_JOINT):
                    state[FIRST_TARGET + j, i] = w[TARGET_NOW + j * LANES + b]
                for k in range(N_READING):
                    state[FIRST_READING + k, i] = w[READINGS_NOW + k * LANES + b]
                #placed
                for k in range(N_FLAG):
                    flags[k, i] = w[FLAGS + k * LANES + b] != 0.0
                for k in range(N_INFO):
                    info[k, i] = w[INFO + k * LANES + b]
                scatter(w, OBSERVATION + b, obs, i)
        return np.int64(0)

    ended = np.int64(0)
    flat = actions.reshape(actions.size)
    #steps
    start, stop = first_chunk(rows, thread)
    while start < stop:
        for k in range(start * N_ACTION, stop * N_ACTION):
            ended -= flat[k] - flat[k] != 0.0
        if ended < 0:
            return ended
        for column in range(start, stop, LANES):
            for k in range(N_INFO):
                expect(info, k * width + column)
            for k in range(N_OBSERVATION):
                expect(obs, column * N_OBSERVATION + k * LANES)
            for k in range(N_STATE):
                take(w, Q + k * LANES, state, k * width + column)
            for k in range(N_MEMORY):
                take(w, ACTION + k * LANES, state, (N_STATE + k) * width + column)
            for k in range(N_FREE):
                take(w, PARAMETERS + k * LANES, state, (N_STATE + N_MEMORY + k) * width + column)
            for k in range(N_DRAWN):
                row = N_STATE + N_MEMORY + N_FREE + k
                take(w, DRAWN + k * LANES, state, row * width + column)
            take_actions(w, GIVEN, actions, column)
            command(w)
            #noise
            #advance
            report(w)
            for k in range(N_STATE + N_MEMORY):
                expect(state, k * width + column + LANES)
            check(w)
            lost = 0
            for b in range(LANES):
                lost += w[LOST + b] > 0.0
            if lost > 0:
                for b in range(LANES):
                    if w[LOST + b] > 0.0:
                        for k in range(N_STATE):
                            w[Q + k * LANES + b] = state[k, column + b]
                        for k in range(N_ACTUATOR):
                            w[ACTUATOR + k * LANES + b] = state[FIRST_ACTUATOR + k, column + b]
                report(w)
            for k in range(N_JOINT):
                put(w, TARGET_NOW + k * LANES, w, TARGET + k * LANES)
            for k in range(N_READING):
                put(w, READINGS_NOW + k * LANES, w, ANGLES + k * LANES)
            for k in range(N_STATE):
                put(w, Q + k * LANES, state, k * width + column)
            for k in range(N_KEPT):
                put(w, ACTION + k * LANES, state, (N_STATE + k) * width + column)
            for k in range(N_FLAG):
                put(w, FLAGS + k * LANES, flags, k * width + column)
            for k in range(N_INFO):
                put(w, INFO + k * LANES, info, k * width + column)
            put_observations(w, OBSERVATION, obs, column)
        for i in range(start, stop):
            ended += flags[0, i] | flags[1, i]
        start, stop = take_chunk(rows, thread)
    return ended
"""

# marks for an arm with ideal torque sources
IDEAL = {"#advance": ["#start", "for _ in range(substeps):", "    #step"]}
# marks for an arm on a floating base: `place` sets the base's pose with the tip on the target
FLOATING = {
    "#parameters": [
        "for k in range(N_FREE):",
        "    w[PARAMETERS + k * LANES + b] = state[N_STATE + N_MEMORY + k, i]",
    ],
    "#place": ["place(w)"],
    "#placed": [
        "for k in range(N_ANCHOR):",
        "    state[FIRST_ANCHOR + k, i] = w[ANCHOR + k * LANES + b]",
    ],
}
# marks for an arm on a fixed base
STANDING: dict[str, list[str]] = {mark: [] for mark in FLOATING}
# marks for an arm with exact sensors
EXACT: dict[str, list[str]] = {"#sensors": [], "#noise": []}
