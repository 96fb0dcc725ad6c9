"""Words of the environments' pages: the common page, and the tables of names."""

from dynamics.simulation.validity import LARGEST_RATE
from flexarm_env.accuracy.certificates import AUTO_TOLERANCE
from flexarm_env.task.scales import DEFLECTION_LIMIT, MOVE
from flexarm_env.task.tasks import SETTLED_BAND

COMMON = """\
# Environments

{ids}

The page of an id has its numbers. This page has the rules that all ids share.

## Use

```python
import gymnasium as gym
import flexarm_env  # registers the ids

env = gym.make("FlexArm/OneLink-Reach-v0")  # one environment
envs = gym.make_vec("FlexArm/OneLink-Reach-v0", num_envs=1024)  # a batch, stepped in one call
sb3_envs = flexarm_env.SB3VecEnv("FlexArm/OneLink-Reach-v0", 1024)  # for stable-baselines3
```

Environment i of a batch with `seed=s` is the single environment with seed s + i. All quantities are
in SI units. `env.unwrapped` has the attributes `arm`, `model`, `task`, `control_dt`,
`torque_limit`, `n_joint`, `reach`, `certificate`, `observation_slices` and `observation_scales`,
and the methods `joint_target()` and `joint_state()`. A batch also has `call`, `get_attr` and
`set_attr`, as Gymnasium's `SyncVectorEnv`.

All ids are at v0, the first, and frozen: an id never changes its dynamics, observations, rewards
or length of an episode. A change gets a new version. `tests/reference/digests.json` holds digests
of what each id computes, as it is and with sensors, `hardware="laboratory"` and drawn parameters,
under random torque, at rest on the target and after a failure; a test compares them.

## Definitions

{terms}

## Actions

`Box(-1, 1, (n_joint,), float32)`: torque of each joint over its torque limit, clipped to [-1, 1]
and constant over a control step. With `base_torque` the last action is that torque. Numbers that
are not finite are refused.

## Observations

`Box((n,), float32)`: each element is a quantity over its scale, clipped to [-{bound:g}, {bound:g}];
sine, cosine and action to [-1, 1].

{observations}

With `obs="goal"` an observation is a dict of `observation`, `achieved_goal` (the tip) and
`desired_goal` (the target). Nothing but `desired_goal` depends on the target, and the reward is
`env.unwrapped.compute_reward(achieved_goal, desired_goal, info)`, for one pair of goals or many: 1
in the settled band, else 0. `SB3VecEnv` takes stable-baselines3's `HerReplayBuffer`.

## Rewards

The reward is the sum of weight times term. Goals lie in [0, 1], costs are at most 0. Joint rates
are in units of the rate scale, tip speeds (relative to the target) in units of the speed scale. The
columns are the presets of `reward=`; a dict sets other weights.

{rewards}

## Reset

`reset(seed=..., options=...)` draws the start of the task, except where `options` sets `state`, a
dict of `q` and `v` (one number per coordinate; zeros if left out), or `target`, joint angles. In a
batch, options may have one row per environment that restarts.

Under gravity, links start bent as if the joints had always been held where they are; vibration
comes on top of that. A given `q` is taken as it is.

A batch has Gymnasium's three modes, `gym.make_vec(..., autoreset_mode=...)`. An ended episode
restarts in the next step (`"NextStep"`, the default), in the same step (`"SameStep"`, with
`final_obs` and `final_info`), or, with `"Disabled"`, when the caller says
`reset(options={{"reset_mask": terminated | truncated}})`.

All random numbers come from streams of the environments' own. `reset(seed=...)` seeds them, and so
does a generator that is assigned, `env.np_random = generator`, at once.

## Events and cost

With `event` something happens once in an episode, at the start of a control step. Its time is drawn
uniformly from {earliest:g} to {latest:g} move times after the start of the episode, its sizes and
signs with it, all from the environment's own stream. No observation shows it ahead, and none shows
the payload: a policy sees what the motion shows, and where the target is now. `info["event"]` is 1
from the step of the event on. `event` goes with every task, arm and hardware, but a jump needs a
fixed base. Derivatives take an event as it was drawn.

{events}

`curvature_limit` c gives `info["cost"]`, for learners with constraints: per control step, at its
end, max(0, max_g |kappa_g| / (c kappa_g,10 %) - 1). Here kappa_g is the true curvature at strain
gauge g, and kappa_g,10 % that under a tip force that deflects the link by 10 % of its length. The
strain of a section is its curvature times the distance from the neutral axis. The reward does not
hold the cost. On OneLink-ReachStrain, whose limit is 0.4, `lqr` exceeds it by 28 % in full torque,
and the slower `inverse` and `pd-zvd` stay within: [harder tasks](../results/harder.md).

## Floating base

The base of an arm with `base: {{"type": "planar"}}` floats in the plane of the motion and turns.
Neither force nor torque acts on it, unless `base_torque` gives a limit: then a torque from outside
turns it, as that of thrusters, or of a reaction wheel whose momentum is not counted. The task is
Reach, and the target is a point that rests in the world. It is the tip of the straight-link arm
after the joints went from their start to the target joint angles, all at the same share of the way,
with rigid links and zero momentum. The arm can therefore reach it without `base_torque`. Other
paths of the joints turn the base by other angles, and other postures hold the tip there too.
`joint_error` and `joint_target()` are about one such posture; `tip_error`, rewards and `settled`
are about the point alone. If `options` sets rates, the target is still that of zero momentum.

Momentum in `info` is that of all bodies without the spin of motor rotors. Without `base_torque` it
is constant but for the error of the integration; a dropped payload takes its share along.

## Termination and truncation

- Terminated, `info["invalid"]`: a link deflects by more than {deflection:.0%} of its length, or
  its tip turns by more than {slope:.2g} rad (the slope of the first shape of a beam on a light hub
  at that deflection).
- Terminated, `info["diverged"]`: a deflection exceeds {lost:g} times that limit, or the state is
  not finite or too large. In the second case observation and info show the state before the step.
- Truncated: the episode has the number of steps on the page of the id.

## Info

{info}

## Keywords

{keywords}

## Keywords that may change

`reward`, `deflection_limit` and `randomize` may change while an environment runs, and so may
`max_episode_steps` of a batch:

```python
env.unwrapped.deflection_limit = 0.05  # or env.set_wrapper_attr("deflection_limit", 0.05)
envs.set_attr("deflection_limit", 0.05)  # for all environments of a batch, and of SB3VecEnv
```

Weights and limits hold from the next step, ranges from the next episode. A new value replaces the
former one as a whole: parameters that `randomize` leaves out take the range of the hardware, or
else their nominal value. Parameters are drawn only if `randomize` or `hardware` named them at
construction. `randomize={{"payload_mass": (0.0, 0.0)}}` names one and leaves the arm as it is.
Where new ranges need a finer integration step, it is taken; `certificate` and `uncertified` are
those of the new values.

Values are checked as at construction. Every other keyword needs a new environment, and setting it
is refused. `gym.make` puts wrappers round the environment: without `unwrapped`, an assignment stays
on the outermost one. Copies and pickles keep the changes; `env.spec` tells how the environment was
made. Controllers keep the ranges for which they were built.

## Pictures and films

`render_mode="rgb_array"` needs no display. Films by Gymnasium's `RecordVideo` and
stable-baselines3's `VecVideoRecorder` need MoviePy: `pip install -c constraints.txt -e ".[video]"`.

```python
from gymnasium.wrappers import RecordVideo

env = gym.make("FlexArm/OneLink-Reach-v0", render_mode="rgb_array")
env = RecordVideo(env, "films")  # films/rl-video-episode-0.mp4
```

## Hardware

`hardware="laboratory"` has the sensors of a real arm and a plant that differs between episodes. A
dict sets single numbers, `{{"encoder_counts": 4096, "delay": 1}}`, or changes some of a preset's,
`{{"preset": "laboratory", "delay": (0, 1)}}`. What is left out stays ideal, but joint rates are
always differences of two angles over a control step. Bias, delay, payload and stiffness are drawn
at every reset, noise at every step, from the environment's own stream; `info` keeps the exact
values. `randomize` replaces payload and stiffness.

{hardware}

`{{"preset": "laboratory", "accelerometer_noise": 0.01}}` fits an accelerometer to the tip, with
noise of 1 % of the acceleration scale. The observation has its reading, `tip_acceleration`: the
specific force, acceleration minus gravity, along the axes of the bent last link at its tip. Its x
points outwards, y and z across; a planar arm has no z. An arm at rest therefore reads gravity,
upwards. The reading is a mean over the control step: the change of the tip's velocity in the world
over `control_dt`, minus gravity, along the axes at the end of the step. Vibrations much faster than
the control step average out. At a reset the tip counts as unaccelerated. The accelerometer changes
no other reading.

## Accuracy

The certificate of an id (`env.unwrapped.certificate`) says how far the tip of the simulated arm may
be from that of the arm as described, in whole episodes at the id's own torque limits. Both play the
same actions from the same start, {count} episodes of each kind:

{kinds}

The error of an episode is the largest distance of the two tips until one of them ends it, by
bending too far for instance. A table has its median, the 95 % within which 95 of 100 episodes stay,
with an interval of 95 % confidence, and the worst; the mean length of the episodes; the times at
which the 95 % of the episodes that still go on passes a thousandth and a hundredth of the reach;
and `growth`: how far apart the tips get, in units of {disturbance:g} of the reach, where every
joint starts {disturbance:g} rad beside its place. Where it is large, two simulations that differ by
anything at all part company, and comparing trajectories stops to mean anything. The errors of the
worst kind by cause:

{certificate}

The reference cuts every link into segments, with three bending modes each, that bend to fourth
order; a damping ratio is that of every natural mode of the link in either. `reference` is one of
the values of `fidelity`, so that anyone can play any motion on it.

For each integrator the table of steps has the fewest substeps that keep the error of model and step
together within {tip_error:g} of the reach, or within {slack:g} times that of the model where
motions grow apart in time ({shaken:g} times where links vibrate from the start), as long as the
model keeps within {parted:g} of the reach, and on a floating base the momentum within
{momentum_error:g} of the base's own.
The environment uses the first row. It has the least CPU time, where a tenth more time is accepted
for a tenth of the error. CPU time is per control step of one environment in a batch of {batch}, on
the machine that measured.

A certificate holds for what it measured: for the torque limits and the bending of the id, and in a
second table for what `hardware="laboratory"` draws. Without one, `env.unwrapped.uncertified` says
what is not covered. `flexarm certify` measures any arm, id and keywords, such as

```bash
flexarm certify slim --set 'randomize={{payload_mass: [0, 0.3]}}'
```

and `gym.make` with the same arm and keywords then takes the step that was found, and has the
certificate.
"""

TERMINOLOGY = (
    (
        "coordinates q",
        "joint angles `q1`, ... [rad]; modal amplitudes `d1_1`, ... [m] of link 1, ...; before "
        "them `base_px`, `base_py` [m], `base_rz` [rad] of a floating base",
    ),
    ("straight-link arm", "the arm at its joint angles with all modal amplitudes zero"),
    (
        "target",
        "tip of the straight-link arm at the target joint angles; on a floating base see below",
    ),
    ("reach", "length of the stretched arm"),
    ("locked, free frequencies", "natural frequencies with the joints locked or free"),
    (
        "bang-bang test",
        "all joints take full torque for half a period of the first free frequency, the opposite "
        "torque for the other half, then none",
    ),
    (
        "torque limit",
        "torque that gives each joint the same acceleration, the largest for which the model stays "
        "valid in the bang-bang test; rounded down to two digits. Against gravity, the largest "
        "torque that holds the joint in the postures of the tasks is added, and the test leaves "
        "room for the sag",
    ),
    ("angle scale", f"{MOVE:g} rad"),
    (
        "rate scale",
        "peak joint rate of a bang-bang move by the angle scale at full torque, less what holds "
        "the arm against gravity [rad/s]",
    ),
    ("move time", "duration of this move [s]"),
    ("speed scale", "reach times rate scale [m/s]"),
    (
        "acceleration scale",
        "sum of reach times the joint acceleration of this move, of a tenth of the longest link "
        "times the first locked angular frequency squared, and of gravity [m/s^2]",
    ),
    ("modal scales", "peaks of modal amplitudes [m] and modal rates [m/s] in the bang-bang test"),
    (
        "base travel, base turn",
        "travel [m] and turn [rad] of a floating base per radian that the joints move from the "
        "home posture at zero momentum, summed over the joints",
    ),
    ("settled", f"tip error below {SETTLED_BAND:.0%} of the reach"),
)

PRESENT = {  # observation: (scale, where it is present); its meaning comes from the layout
    "joint_error": ("angle scale", "always"),
    "joint_sin": (
        "1",
        "joint 2 and later; joint 1 only under gravity, on a floating base or behind a fixed link "
        "that bends",
    ),
    "joint_cos": ("1", "as `joint_sin`"),
    "joint_rate": ("rate scale", "always"),
    "base_position": ("0.1 reach", "on a floating base"),
    "base_sin": ("1", "on a floating base"),
    "base_cos": ("1", "on a floating base"),
    "base_velocity": ("base travel times rate scale", "on a floating base"),
    "base_rate": ("base turn times rate scale", "on a floating base"),
    "modal_amplitude": ("modal scale", '`obs="state"`'),
    "modal_rate": ("modal scale", '`obs="state"`'),
    "tip_error": (
        f"{MOVE:g} reach",
        '`obs="state"`; directions in which the tip moves; with one joint, across the link alone',
    ),
    "root_curvature": ("that of a tip force at 10 % deflection", '`obs="sensors"`'),
    "tip_acceleration": ("acceleration scale", "with `accelerometer_noise` in `hardware`"),
    "target_position": ("reach", '`obs="sensors"` on a floating base'),
    "target_rate": ("rate scale", "task Track"),
    "target_near": ("angle scale", "task Track"),
    "target_far": ("angle scale", "task Track"),
    "joint_torque": ("torque limit", "with `actuator`"),
    "last_action": ("1", "always"),
    "achieved_goal": ("reach", '`obs="goal"`'),
    "desired_goal": ("reach", '`obs="goal"`'),
}

INFO = (
    ("time", "s", "since the start of the episode"),
    ("tip_error", "m", "distance from tip to target"),
    ("tip_speed", "m/s", "speed of the tip relative to the target"),
    ("deflection", "-", "largest deflection of a link over its length"),
    ("tip_deflection", "m", "distance from the tip to the tip of the straight-link arm"),
    ("root_curvature", "1/m", "at the root of each link, per bending direction"),
    ("torque", "N m", "at the joints, at the end of the step; last that of `base_torque`"),
    ("command", "V or N m", "command of the action, with `actuator` only"),
    ("linear_momentum", "N s", "of all bodies along x and y of the world, on a floating base only"),
    (
        "angular_momentum",
        "N m s",
        "of all bodies about the world's origin along z, on a floating base only",
    ),
    ("event", "-", "1 once the event has happened, else 0; with `event` only"),
    ("cost", "-", "excess of curvature, see above; with `curvature_limit` only"),
    ("reward_terms", "-", "dict of all reward terms"),
    ("settled", "-", "whether the tip error is in the settled band"),
    ("invalid", "-", "whether a link bends beyond its limit, see above"),
    ("diverged", "-", "whether the state diverged, see above"),
    (
        "overspeed",
        "-",
        f"whether a joint turns faster than {LARGEST_RATE:g} of the first locked frequency, where "
        "linear modes lose stiffness; never with foreshortening",
    ),
)

KEYWORDS = (
    ("arm", "the id's",
     "preset name, path to an arm file (.json, .yaml), dict or `Arm`; an arm with `modes: auto` "
     f"takes the cheapest model within {AUTO_TOLERANCE:g} of the reach, as by `tolerance`"),
    ("obs", "None",
     '"state"; "sensors": encoders and strain gauges; "goal": a dict for hindsight replay; None: '
     '"state", or "sensors" beside `hardware`'),
    ("reward", "the task's", "preset name or a dict of weights of reward terms"),
    ("control_dt", "the id's", "[s] time between actions"),
    ("integrator", "None",
     "a method of `dynamics.integrators.table.INTEGRATORS`; None: the measured best; for an arm "
     "that was not measured, by rule the fewest evaluations for an error of 1e-3 of the reach"),
    ("substeps", "None", "integration steps per control step; None: chosen with the integrator"),
    ("torque_limit", "None", "[N m] one number or one per joint; None: as defined above"),
    ("base_torque", "None",
     "[N m] largest torque on a floating base, the last action; None: no torque acts on it"),
    ("actuator", "None", "[actuators](../actuators.md) between action and torque; None: ideal"),
    ("hardware", '"ideal"',
     'sensors and spread of the plant: "ideal", "laboratory" or a dict, which may add an '
     "accelerometer"),
    ("event", "the id's", '"drop", "jump" or "push", see above; None: nothing happens'),
    ("curvature_limit", "the id's", "[-] limit of `info[\"cost\"]`, see above; None: no cost"),
    ("deflection_limit", str(DEFLECTION_LIMIT), "[-] deflection over length that ends an episode"),
    ("max_episode_steps", "the id's",
     "control steps after which an episode is truncated; None: the id's; -1: no limit"),
    ("render_mode", "None", '"rgb_array", in a notebook too: `PIL.Image.fromarray(env.render())` '
     'shows it; or "human", a window'),
    ("threads", "1", "largest number of worker threads, `gym.make_vec` only"),
    ("fidelity", '"auto"',
     '"auto", the arm as described; "rigid"; or "reference", fine segments and slow'),
    ("tolerance", "None",
     "[m] replaces `fidelity`: the cheapest model, integrator and step with a smaller tip error "
     "on the motions of the certificate; searched once, then cached"),
    ("dtype", '"float64"', 'number type of the compiled code: "float64" or "float32"'),
    ("randomize", "None",
     "dict of ranges (low, high), drawn at every reset: `payload_mass` [kg], factors on "
     "`stiffness`, `damping` and `friction`, and friction that is added to joint k, `viscous_k` "
     "[N m s/rad] and `coulomb_k` [N m]"),
)  # fmt: skip


HARDWARE = (
    ("encoder_counts", "counts of an encoder per turn of the joint"),
    ("gauge_noise", "standard deviation of a strain gauge, over its scale above"),
    ("gauge_bias", "largest bias of a strain gauge, over its scale"),
    ("gauge_counts", "counts of a strain gauge per scale"),
    ("accelerometer_noise", "standard deviation of the accelerometer, over the acceleration scale"),
    ("delay", "control steps by which all readings are late; one number, or the range"),
    ("payload", "range of the mass added at the tip, over that of the last link with its tip"),
    ("stiffness", "range of the factor on all stiffnesses"),
)
