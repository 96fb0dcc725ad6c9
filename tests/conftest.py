"""The tiers of tests: quick, by day, in the evening, at night.

`python -m pytest -m "quick and not slow"` compiles nothing and takes about a minute. A file joins
it by its name in QUICK; single tests of it that compile carry the marker `compiles`. In every tier,
a quick test that compiles or loads compiled code fails. What night.yaml leaves to the night is
marked `slow`. Of all others those of EVENING are marked `evening`, the rest `day`.
"""

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from dynamics.backends.numba_llvm import program
from tests.paths import ROOT

QUICK = {
    "agents/controllers/observers/test_by_hand.py",
    "agents/controllers/test_by_hand.py",
    "agents/controllers/test_lqr.py",
    "agents/controllers/test_shapers.py",
    "agents/controllers/test_strain.py",
    "agents/leaderboard/test_statistics.py",
    "agents/learners/test_algorithms.py",
    "agents/learners/test_ranges.py",
    "agents/learners/test_zoo.py",
    "agents/run_folder/test_log.py",
    "agents/test_config.py",
    "agents/test_metrics.py",
    "agents/test_policy.py",
    "dynamics/accuracy/test_fidelity.py",
    "dynamics/accuracy/test_scene.py",
    "dynamics/arms/test_presets.py",
    "dynamics/backends/test_block_text.py",
    "dynamics/description/beams/test_stepped_links.py",
    "dynamics/description/test_arm.py",
    "dynamics/description/test_data_file.py",
    "dynamics/description/test_mode_rule.py",
    "dynamics/description/test_parameters.py",
    "dynamics/description/test_rotations.py",
    "dynamics/description/test_thick_links.py",
    "dynamics/description/test_torsion.py",
    "dynamics/description/test_welds.py",
    "dynamics/description/urdf/test_flexible.py",
    "dynamics/formulations/test_christoffel.py",
    "dynamics/formulations/test_dense_solve.py",
    "dynamics/formulations/test_fixed_joints.py",
    "dynamics/formulations/test_free_base.py",
    "dynamics/formulations/test_gibbs_appell.py",
    "dynamics/formulations/test_joints.py",
    "dynamics/formulations/test_link_constants.py",
    "dynamics/formulations/test_parallel_drive.py",
    "dynamics/integrators/test_orders.py",
    "dynamics/measured/test_log_file.py",
    "dynamics/simulation/test_case_file.py",
    "dynamics/simulation/test_large_deflection.py",
    "dynamics/tracing/test_adjoint.py",
    "dynamics/tracing/test_differentiated.py",
    "dynamics/tracing/test_measure.py",
    "dynamics/tracing/test_recorded_steps.py",
    "dynamics/tracing/test_singular.py",
    "dynamics/tracing/test_statements.py",
    "flexarm_env/hardware/test_actuators.py",
    "flexarm_env/task/test_events.py",
    "flexarm_env/task/test_reward_terms.py",
    "flexarm_env/task/test_tasks.py",
    "flexarm_env/test_holding.py",
    "test_layers.py",
    "test_release.py",
}


EVENING = {  # long files, of quick ones what compiles; .ci/run takes them after the README's line
    "agents/controllers/models/test_linear_model.py",
    "agents/controllers/models/test_plan.py",
    "agents/controllers/models/test_preview.py",
    "agents/controllers/models/test_reference.py",
    "agents/controllers/observers/test_kalman.py",
    "agents/controllers/test_controllers.py",
    "agents/controllers/test_inverse.py",
    "agents/controllers/test_mpc.py",
    "agents/controllers/test_nmpc.py",
    "agents/controllers/test_pd.py",
    "agents/controllers/test_strain.py",
    "agents/export/test_c_header.py",
    "agents/hybrid/test_hybrid.py",
    "agents/leaderboard/test_bound.py",
    "agents/leaderboard/test_kinds.py",
    "agents/leaderboard/test_output.py",
    "agents/leaderboard/test_run.py",
    "agents/leaderboard/test_stored.py",
    "agents/leaderboard/test_users.py",
    "agents/learners/test_dagger.py",
    "agents/learners/test_export.py",
    "agents/learners/test_normalization.py",
    "agents/learners/test_privileged.py",
    "agents/learners/test_recurrent.py",
    "agents/learners/test_rsl.py",
    "agents/learners/test_runs.py",
    "agents/learners/test_warm_start.py",
    "agents/run_folder/test_checkpoints.py",
    "agents/run_folder/test_folder.py",
    "agents/test_canaries.py",
    "agents/test_films.py",
    "agents/test_fit.py",
    "agents/test_learning.py",
    "agents/test_signals.py",
    "agents/test_sweep.py",
    "agents/test_training.py",
    "agents/tune/test_learners.py",
    "benchmarks/accuracy/test_rigid_arms.py",
    "benchmarks/ranking/test_knowledge.py",
    "benchmarks/ranking/test_on_reference.py",
    "benchmarks/ranking/test_standings.py",
    "benchmarks/speed/test_gpu.py",
    "benchmarks/speed/test_operations.py",
    "benchmarks/speed/test_soak.py",
    "benchmarks/test_output.py",
    "benchmarks/test_paper.py",
    "benchmarks/test_results.py",
    "benchmarks/test_scenarios.py",
    "benchmarks/test_style.py",
    "benchmarks/test_work_precision.py",
    "benchmarks/training/test_distilled.py",
    "benchmarks/training/test_experiments.py",
    "benchmarks/training/test_learning.py",
    "benchmarks/training/test_training.py",
    "docs/test_door.py",
    "docs/test_pages.py",
    "docs/test_rod.py",
    "dynamics/accuracy/test_kinds_of_arms.py",
    "dynamics/accuracy/test_model_choice.py",
    "dynamics/accuracy/test_rollout.py",
    "dynamics/accuracy/test_same_shape.py",
    "dynamics/backends/test_program.py",
    "dynamics/backends/test_vector_code.py",
    "dynamics/description/beams/test_stepped_links.py",
    "dynamics/description/test_carried.py",
    "dynamics/description/test_denavit_hartenberg.py",
    "dynamics/description/test_parameters.py",
    "dynamics/description/urdf/test_against_pinocchio.py",
    "dynamics/description/urdf/test_flexible.py",
    "dynamics/formulations/test_christoffel.py",
    "dynamics/formulations/test_fixed_joints.py",
    "dynamics/formulations/test_formulations.py",
    "dynamics/formulations/test_formulations_compiled.py",
    "dynamics/formulations/test_gibbs_appell.py",
    "dynamics/formulations/test_joints.py",
    "dynamics/formulations/test_parallel_drive.py",
    "dynamics/formulations/test_planar_base.py",
    "dynamics/integrators/test_integrators.py",
    "dynamics/measured/test_fit.py",
    "dynamics/measured/test_rig.py",
    "dynamics/measured/test_slopes.py",
    "dynamics/measured/test_start.py",
    "dynamics/runtime/test_jit.py",
    "dynamics/runtime/test_numba_internals.py",
    "dynamics/runtime/test_thread_pool.py",
    "dynamics/simulation/test_free_base_motion.py",
    "dynamics/simulation/test_sampled_motion.py",
    "dynamics/simulation/test_step_limits.py",
    "dynamics/simulation/test_stepper.py",
    "dynamics/test_cache.py",
    "dynamics/test_main.py",
    "dynamics/test_nonsense.py",
    "dynamics/tracing/test_equilibrium.py",
    "flexarm_env/accuracy/test_own_arms.py",
    "flexarm_env/certify/test_certificate.py",
    "flexarm_env/certify/test_choice.py",
    "flexarm_env/compiled/test_happening.py",
    "flexarm_env/hardware/test_accelerometer.py",
    "flexarm_env/hardware/test_actuators.py",
    "flexarm_env/hardware/test_sensors.py",
    "flexarm_env/interfaces/tensors/test_device.py",
    "flexarm_env/interfaces/tensors/test_differentiable.py",
    "flexarm_env/interfaces/test_sb3.py",
    "flexarm_env/test_derivatives.py",
    "flexarm_env/test_floating_base.py",
    "flexarm_env/test_goals.py",
    "flexarm_env/test_holding.py",
    "flexarm_env/test_joint_kinds.py",
    "flexarm_env/test_nonsense.py",
    "flexarm_env/test_plant.py",
    "flexarm_env/test_rendering.py",
    "flexarm_env/test_settings.py",
    "flexarm_env/test_source.py",
    "flexarm_env/test_specs.py",
    "flexarm_env/test_step_infos.py",
    "flexarm_env/test_urdf.py",
    "test_commands.py",
}
FIRST = (  # long files; what the first one compiles is shared, and the second needs none of it
    "flexarm_env/test_digests.py",
    "dynamics/integrators/test_integrators.py",
    "dynamics/simulation/test_stepper.py",
    "dynamics/accuracy/test_model_choice.py",
    "flexarm_env/test_episodes.py",
    "agents/controllers/test_controllers.py",
    "dynamics/backends/test_vector_code.py",
)
# file -> test -> parts of the ids of the parameters that run by day
NIGHT = yaml.safe_load((ROOT / "tests" / "night.yaml").read_text("utf-8"))


def name_of(item: pytest.Item) -> str:
    """File of a test, from the folder of tests on."""
    return Path(item.path).relative_to(ROOT / "tests").as_posix()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave the files of the evening alone by day, for the time that their imports take."""
    by_day = config.option.markexpr == "day"
    late = (ROOT / "tests" / name for name in EVENING - QUICK)
    return True if by_day and collection_path in late else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: k for k, name in enumerate(FIRST)}
    items.sort(key=lambda item: order.get(name_of(item), len(order)))
    for item in items:
        name = name_of(item)
        if name in QUICK and not item.get_closest_marker("compiles"):
            item.add_marker("quick")
        test, bracket, parameters = item.name.partition("[")
        by_day = NIGHT.get(name, {}).get(test)
        if by_day is not None and not any(part in bracket + parameters for part in by_day):
            item.add_marker("slow")
        if not item.get_closest_marker("slow"):
            long = name in EVENING and not item.get_closest_marker("quick")
            item.add_marker("evening" if long else "day")


def pytest_collection_finish() -> None:
    """Keep what was collected out of later sweeps for garbage."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def nothing_is_compiled(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Hold quick tests to their promise."""
    if request.node.get_closest_marker("quick") is None:
        yield
        return
    from numba.core import event

    def refused(name: str, text: str) -> None:
        raise AssertionError(f"a quick test loads compiled code: {name}")

    monkeypatch.setattr(program, "_executed", refused)
    with event.install_recorder("numba:compile") as compilations:
        yield
    assert not compilations.buffer, "a quick test compiles"
