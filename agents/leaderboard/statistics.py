"""Statistics of episodes: interquartile mean, improvement over others, profile, spectrum.

The first three are those of Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the
Statistical Precipice". Values are (runs, episodes): a row per training seed of a policy, one row
for any other controller. The test episodes are the same in every row and for every controller.

Intervals are 95 % percentile bootstrap intervals. A resample draws runs, those of every controller
by themselves, and whole episodes, the same in all rows: comparisons stay within an episode. With
one run the interval covers the choice of the episodes alone.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import signal, stats

from agents.metrics import Best, Recording, excesses, regrets
from dynamics.types import AnyArray
from flexarm_env.task.tasks import SETTLED_BAND

RESAMPLES = 2000  # of the bootstrap
ENDS = (2.5, 97.5)  # [%] of resamples that lie below an interval's ends
EPISODES = 0  # stream of the drawn episodes; those of runs are above it
SEGMENT = 1 / 3  # of an episode: length of a segment of a spectrum
PADDING = 4  # transform over segment
DIGITS = 4  # significant ones of the metrics of an episode
DECIMALS = 4  # of improvements, as pages show them
Figures = dict[str, Any]


class Spectrum(NamedTuple):
    """Power spectral density of the curvature at the links' roots."""

    frequency: AnyArray  # (f,) [Hz]
    density: AnyArray  # (f,) [1/m^2/Hz] median over episodes
    share: float  # [-] of episodes that are long enough after reaching the target


@dataclass(frozen=True)
class Entry:
    """A controller on a task and track."""

    figures: Figures  # of leaderboard.json
    metrics: Mapping[str, AnyArray]  # (runs, episodes) each of METRICS
    spectrum: Spectrum
    seeds: Sequence[int]  # (episodes,)

    @property
    def privileged(self) -> bool:
        """True for `optimal`, which is told the episodes and not ranked."""
        return bool(self.figures["privileged"])


def rounded(values: AnyArray) -> AnyArray:
    """Metrics as they are stored, so that stored ones lead to the same figures."""
    return np.array([float(f"{x:.{DIGITS}g}") for x in values.flat]).reshape(values.shape)


def figures(
    metrics: Mapping[str, AnyArray],
    best: Best | None,
    *,
    privileged: bool = False,
    learned: bool = False,
) -> Figures:
    """Figures of one controller from metrics (runs, episodes).

    The runs of a learned one are its training seeds; other controllers have none, and one run.

    Without the best that is known of the episodes there is no regret; with a resting target there
    is no excess of the RMS tip error [m] over the smallest known.
    """
    score = metrics["score"]
    regret = None if best is None else regrets(metrics, best)
    excess = None if best is None or not best.of_path else excesses(metrics, best)
    return {
        "privileged": privileged,
        "training_seeds": score.shape[0] if learned else 0,
        "episodes": score.shape[-1],
        "success_rate": float(metrics["success"].mean()),
        "score_mean": float(score.mean()),
        "score_mean_moves": moves(score),
        "score_iqm": interquartile_mean(score),
        "score_ci": interval(score),
        "regret_iqm": None if regret is None else interquartile_mean(regret),
        "regret_ci": None if regret is None else interval(regret),
        "excess_iqm": None if excess is None else interquartile_mean(excess),
        "excess_ci": None if excess is None else interval(excess),
        "regret_episodes": 0 if regret is None else regret.shape[-1],
        "settling_median": float(np.median(metrics["settling_time"])),
        "settling_quartiles": quartiles(metrics["settling_time"]),
        "tip_error_rms_median": float(np.median(metrics["tip_error_rms"])),
        "residual_vibration_median": float(np.median(metrics["residual_vibration"])),
        "residual_vibration_quartiles": quartiles(metrics["residual_vibration"]),
    }


def decisions(milliseconds: AnyArray, control_dt: float) -> Figures:
    """Figures of the times of single decisions, of which the first starts the controller.

    All are beside the control step [s]; the first is in none of the others.
    """
    first, later = milliseconds[0], milliseconds[1:]
    return {
        "ms_first_action": float(first),
        "ms_per_action": float(np.median(later)),
        "ms_per_action_p99": float(np.percentile(later, 99.0)),
        "ms_control_step": 1e3 * control_dt,
        "late_share": float(np.mean(later > 1e3 * control_dt)),
    }


def interquartile_mean(values: AnyArray) -> float:
    """Mean of the middle half of values (runs, episodes)."""
    return float(stats.trim_mean(values, 0.25, axis=None))


def moves(values: AnyArray) -> float:
    """Standard deviation of the difference of two means, of so many episodes each."""
    return float(values.mean(axis=0).std(ddof=1) * math.sqrt(2.0 / values.shape[-1]))


def interval(values: AnyArray) -> list[float]:
    """[low, high] of the interquartile mean of values (runs, episodes), some perhaps infinite."""
    with np.errstate(invalid="ignore"):  # between infinite resamples
        low, high = np.percentile(resampled_means(values), ENDS)
    return [float(np.nan_to_num(x, nan=np.inf, posinf=np.inf)) for x in (low, high)]


def resampled_means(values: AnyArray, stream: int = 1) -> AnyArray:
    """(RESAMPLES,) interquartile means of resampled runs and episodes of values (runs, episodes).

    Controllers whose runs are independent have streams of their own, and all share the episodes.
    """
    runs, episodes = _drawn(len(values), stream), _drawn(values.shape[1], EPISODES)
    drawn = values[runs[:, :, None], episodes[:, None, :]]
    return np.asarray(stats.trim_mean(drawn.reshape(RESAMPLES, -1), 0.25, axis=1))


def wins(values: AnyArray, others: AnyArray) -> AnyArray:
    """1 where values exceed the others in an episode, a half where they tie, else 0.

    `values` are (runs, episodes), `others` (other runs, episodes); (runs, other runs, episodes).
    """
    return 0.5 + 0.5 * np.sign(values[:, None] - others)


def improvements(scores: Mapping[str, AnyArray]) -> dict[str, dict[str, Any]]:
    """Gains of every controller on the others, and probabilities to score above them.

    From scores (runs, episodes) by controller: {controller: {other: figures}}, which are the
    probability `p` with its interval `ci`, and the difference of the interquartile means, `gain`
    with `gain_ci`. Both controllers have the same episodes in a resample, so that the interval of
    the gain is without what makes episodes easy or hard for both.
    """
    found: dict[str, dict[str, Any]] = {name: {} for name in scores}
    streams = {name: stream for stream, name in enumerate(scores, EPISODES + 1)}
    resamples = {name: resampled_means(x, streams[name]) for name, x in scores.items()}
    means = {name: interquartile_mean(x) for name, x in scores.items()}
    for one, other in combinations(scores, 2):
        share = wins(scores[one], scores[other])
        low, high = np.percentile(_mean_shares(share, streams[one], streams[other]), ENDS)
        least, most = np.percentile(resamples[one] - resamples[other], ENDS)
        p, gain = share.mean(), means[one] - means[other]
        found[one][other] = _over(p, (low, high), gain, (least, most))
        found[other][one] = _over(1.0 - p, (1.0 - high, 1.0 - low), -gain, (-most, -least))
    return found


def _over(p: float, ci: tuple[Any, Any], gain: float, gain_ci: tuple[Any, Any]) -> Figures:
    values = np.round([p, *ci, gain, *gain_ci], DECIMALS) + 0.0  # no negative zero
    p, low, high, gain, least, most = values.tolist()
    return {"p": p, "ci": [low, high], "gain": gain, "gain_ci": [least, most]}


def compared(found: Mapping[str, Entry]) -> dict[str, Entry]:
    """Entries of a task and track, with the improvements over each other among their figures."""
    better = improvements(
        {name: entry.metrics["score"] for name, entry in found.items() if not entry.privileged}
    )
    return {
        name: replace(entry, figures=entry.figures | {"improvement": better.get(name, {})})
        for name, entry in found.items()
    }


def profile(scores: AnyArray, levels: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Shares of episodes that score above each level, and their lower and upper bounds.

    From scores (runs, episodes) and levels (k,): three arrays (k,).
    """
    above = 1.0 * (scores > levels[:, None, None])
    means = np.array([_mean_shares(level[:, None], 1, 1) for level in above])
    low, high = np.percentile(means, ENDS, axis=1)
    return above.mean(axis=(1, 2)), low, high


def quartiles(values: AnyArray) -> list[float]:
    """[lower, upper] quartile of values of which some may be infinite: two of the values."""
    return [float(x) for x in np.quantile(values, (0.25, 0.75), method="inverted_cdf")]


def spectrum(recordings: Sequence[Recording]) -> Spectrum:
    """Spectrum of the curvature from where the tip first reached the target to the end.

    By Welch's method per episode, summed over the links' roots. Episodes that fail, or of which
    less than a segment is left, are not in it.
    """
    r = recordings[0]
    size = round(SEGMENT * r.duration / (r.time[1] - r.time[0]))
    rate = 1.0 / (r.time[1] - r.time[0])
    found = []
    for r in recordings:
        reached = r.tip_error < SETTLED_BAND * r.reach
        first = np.where(reached.any(axis=0), reached.argmax(axis=0), len(r.time))
        for k in np.flatnonzero(~r.failed & (first + size <= len(r.time))):
            frequency, density = signal.welch(
                r.root_curvature[first[k] :, k], rate, nperseg=size, nfft=PADDING * size, axis=0
            )
            found.append(density.sum(axis=1))
    frequency = np.fft.rfftfreq(PADDING * size, 1.0 / rate)
    density = np.median(found, axis=0) if found else np.full(frequency.size, np.nan)
    return Spectrum(frequency, density, len(found) / sum(r.failed.size for r in recordings))


def _mean_shares(shares: AnyArray, stream: int, other: int) -> AnyArray:
    """(RESAMPLES,) means of shares (runs, other runs, episodes) over what is drawn of each."""
    streams = (stream, other, EPISODES)
    weights = (_weights(n, stream) for n, stream in zip(shares.shape, streams, strict=True))
    return np.asarray(np.einsum("abe,ra,rb,re->r", shares, *weights, optimize=True))


@cache
def _drawn(count: int, stream: int) -> AnyArray:
    """(RESAMPLES, count) numbers of the runs or episodes in every resample."""
    return np.random.default_rng(stream).integers(count, size=(RESAMPLES, count))


@cache
def _weights(count: int, stream: int) -> AnyArray:
    """(RESAMPLES, count) share that a run or an episode has in every resample."""
    places = _drawn(count, stream) + count * np.arange(RESAMPLES)[:, None]
    return np.bincount(places.ravel(), minlength=places.size).reshape(places.shape) / count
