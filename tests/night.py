"""Tests left to the night: their file, their name, and the parameters that also run by day.

Tests that say `slow` where they are written are left to the night too. What stays by day holds
every capability and every refusal; the night adds further arms, methods, tasks and sizes.
"""

ONE, TWO = "OneLink-Reach-v0", "TwoLink-Reach-v0"

SOME_ARMS, SOME_DRIVES = ("(0, 1", "(3, 2", "(2, 3"), ("(0, 2", "(2, 3")

# file -> test -> parts of the ids of the parameters that run by day
NIGHT: dict[str, dict[str, tuple[str, ...]]] = {
    "agents/controllers/models/test_memory.py": {
        "test_a_controller_goes_when_nobody_holds_it": ("[pd]", "[lqg]"),
    },
    "agents/controllers/models/test_plan.py": {
        "test_a_move_takes_its_share_of_torque_or_of_bending": ("kwargs1",),
        "test_filters_follow_the_arm_along_a_plan": (),
    },
    "agents/controllers/models/test_preview.py": {
        "test_torques_ahead_are_those_of_the_path_later_on": ("[32]",),
        "test_the_path_is_that_of_the_target": ("[32",),
        "test_predictive_control_prepares_for_torques_that_it_will_lack": (),
    },
    "agents/controllers/observers/test_extended.py": {
        "test_fast_links_are_followed_where_linear_filters_lose_them": (),
        "test_a_slow_link_is_estimated_as_by_linear_filters": (),
        "test_on_a_path_estimates_are_what_exact_states_show": (),
        "test_refuted_filters_end_and_nothing_else_changes": (),
        "test_where_every_filter_is_lost_all_begin_anew_and_find_the_arm_again": (),
        "test_what_observations_show_lies_within_their_bound_about_the_target": (),
    },
    "agents/controllers/test_controllers.py": {
        "test_every_controller_takes_one_observation_or_a_batch": (ONE,),
        "test_an_episode_does_not_depend_on_those_beside_it": ("OneLink-Track",),
        "test_tuned_controllers_settle_the_one_link_arm": ("[pd]", "[lqr]"),
        "test_reward_thresholds_are_a_little_below_the_mean_return_of_lqr": (ONE,),
    },
    "agents/leaderboard/test_shipped_bounds.py": {
        "test_stored_torques_reach_their_bounds": (ONE,),
    },
    "agents/leaderboard/test_stored.py": {
        "test_drawn_episodes_of_the_ranking_are_reproduced": ("OneLink-Reach-v0-state",),
    },
    "agents/learners/test_export.py": {
        "test_a_trusted_zip_of_every_algorithm_loads": ("ppo", "sac"),
    },
    "agents/learners/test_runs.py": {
        "test_a_run_of_every_algorithm_resumes_and_is_evaluated": ("[ppo]",),
        "test_exploration_that_depends_on_the_state_is_trained_and_resumed": (),
    },
    "agents/run_folder/test_fuzz.py": {
        "test_a_few_damages_kills_and_full_disks_lose_nothing": (),
    },
    "agents/test_learning.py": {
        "test_training_raises_the_return_of_the_deterministic_policy": (),
        "test_a_learning_rate_of_zero_changes_no_return": (),
    },
    "agents/test_signals.py": {
        "test_a_signal_ends_a_run_at_a_checkpoint_where_it_resumes": ("[15]",),
        "test_the_second_signal_stops_at_once": ("[2]",),
        "test_a_signal_stops_an_evaluation_at_once_and_resuming_repeats_it": (),
        "test_a_signal_before_the_run_creates_no_folder": (),
    },
    "benchmarks/test_work_precision.py": {
        "test_errors_fall_at_the_order_of_the_method": ("numerov",),
    },
    "benchmarks/test_stability.py": {
        "test_a_method_fails_exactly_where_its_amplification_predicts": ("rk4", "[midpoint"),
    },
    "docs/test_pages.py": {
        "test_the_python_of_a_page_runs": ("own_arm",),
        "test_a_film_of_every_id_moves_and_is_small": (ONE,),
    },
    "dynamics/accuracy/test_model_choice.py": {
        "test_the_choice_for_a_scene_has_the_modes_that_it_needs_and_no_more": ("[heavy hub",),
        "test_the_compiled_choice_is_as_good_as_claimed": ("[heavy hub",),
        "test_the_claim_holds_against_a_beam_without_assumed_modes": (),
        "test_the_choice_with_one_mode_less_exceeds_the_tolerance": ("[heavy hub",),
        "test_a_fast_spin_breaks_the_linear_model": (),
        "test_the_ladder_separates_truncation_from_nonlinearity": (),
        "test_a_choice_converts_to_json_and_to_a_table": (),
        "test_the_arms_own_modes_select_the_family_of_shapes": (),
        "test_a_damped_arm_gets_no_larger_model_than_an_undamped_one": (),
    },
    "dynamics/accuracy/test_rollout.py": {
        "test_traced_steps_are_the_compiled_steps": ("numerov", "exponential-2"),
        "test_steps_under_a_held_torque_are_those_of_a_stepper": ("numerov", "exponential-2"),
    },
    "dynamics/backends/test_vector_code.py": {
        "test_rows_move_between_workspace_and_arrays": ("C-float64",),
        "test_blocks_of_rows_are_transposed": (
            "0-moves-float64-float32-3-",
            "1-plain_code-float32-float64-16-",
        ),
    },
    "dynamics/formulations/test_formulations.py": {
        "test_mass_matrix_is_the_metric_of_kinetic_energy": SOME_ARMS,
        "test_equations_are_the_gradient_of_the_energy_of_acceleration": SOME_ARMS,
        "test_the_recursion_holds_for_one_to_six_links_with_up_to_three_modes": (
            "[1-",
            "[2-2",
            "[3-1",
        ),
        "test_accelerations_solve_the_formulations_own_equations": SOME_ARMS,
        "test_kinetic_energy_is_the_quadratic_form_of_the_mass_matrix": SOME_ARMS,
        "test_energy_changes_by_the_work_of_torques": SOME_ARMS,
        "test_book_conserves_energy_even_where_E_is_no_rotation": ("(3, 2",),
        "test_siblings_agree_with_the_recursion": SOME_ARMS,
        "test_the_complement_shares_the_convention_of_the_recursion": ("(3, 2",),
        "test_a_straight_arm_knows_no_convention": ("(3, 2",),
        "test_siblings_follow_the_same_motion": (),
    },
    "dynamics/formulations/test_parallel_drive.py": {
        "test_equations_are_those_of_brute_force": SOME_DRIVES,
        "test_elimination_solves_the_composite_equations": SOME_DRIVES,
        "test_implicit_elimination_solves_the_augmented_equations": SOME_DRIVES,
        "test_mass_matrix_is_the_metric_of_the_kinetic_energy": SOME_DRIVES,
        "test_tip_and_its_velocity_are_those_of_brute_force": SOME_DRIVES,
        "test_compiled_accelerations_are_those_of_floats": ("[16-(1, 2",),
    },
    "dynamics/integrators/test_integrators.py": {
        "test_error_falls_at_the_order_of_the_method": ("undamped", "numerov", "[midpoint"),
        "test_damping_breaks_a_method_exactly_where_its_eigenvalues_say": ("1.5", "8.0"),
    },
    "dynamics/simulation/test_free_base_motion.py": {
        "test_momentum_and_energy_of_a_free_arm_are_conserved_over_10_000_steps_of_dop853": (),
        "test_steps_converge_with_their_order": ("rk4",),
        "test_implicit_methods_with_error_control_agree": (),
        "test_a_batch_steps_every_environment_as_if_alone": ("rk4",),
        "test_float32_steps_agree_with_float64_to_single_precision": (),
        "test_a_beam_on_a_massless_base_has_the_frequencies_of_a_free_free_beam": (),
        "test_a_shaft_on_a_massless_base_has_the_frequencies_of_a_free_free_shaft": (),
        "test_a_free_base_adds_operations_but_does_not_triple_them": (),
    },
    "dynamics/simulation/test_stepper.py": {
        "test_an_environment_does_not_depend_on_the_size_of_its_batch": ("numerov", "[rk4"),
        "test_float32_is_float64_to_single_precision": ("[rk4",),
        "test_an_environment_does_not_depend_on_threads": ("numerov-3", "[rk4-3"),
        "test_an_environment_does_not_depend_on_its_lane": ("numerov", "[rk4"),
        "test_a_single_environment_equals_the_batch_to_round_off": ("numerov", "[rk4"),
        "test_a_stepper_may_change_its_step": ("[numerov-float64", "[rk4-float64"),
        "test_free_parameters_act_like_an_arm_compiled_with_their_values": ("[rk4",),
    },
    "flexarm_env/test_batch.py": {
        "test_batch_equals_single_environments": ("Reach-OneLink",),
        "test_results_do_not_depend_on_batch_size_or_threads": ("Reach]",),
    },
    "flexarm_env/test_digests.py": {
        "test_an_environment_gives_its_stored_results": (
            f"{ONE}-default",
            f"{ONE}-settled",
            f"{ONE}-broken",
            f"{TWO}-default",
            f"{TWO}-settled",
            f"{TWO}-broken",
        ),
        "test_an_environment_takes_its_steps": (ONE, TWO),
    },
    "flexarm_env/test_episodes.py": {
        "test_no_observation_element_is_constant_or_duplicated": (ONE, f"{TWO}-state"),
        "test_observations_are_of_order_one": (ONE, TWO),
        "test_random_episodes_stay_finite": (ONE, TWO, "SixLink-Reach"),
        "test_an_arm_without_torque_reaches_the_end_of_its_episode": ("One",),
        "test_bang_bang_bends_hard_but_stays_valid": ("One",),
        "test_a_forced_divergence_ends_the_episode": ("One",),
        "test_overspeed_is_set_beyond_half_the_first_locked_frequency": ("1.1",),
        "test_default_integration_keeps_the_tip_within_a_thousandth_of_the_reach": ("One",),
        "test_episodes_start_uniformly_in_the_ranges_of_their_page": ("One",),
        "test_damp_vibrates_by_up_to_sixty_percent_of_the_bang_bang_peaks": ("One",),
    },
    "flexarm_env/test_interface.py": {
        "test_both_checkers_pass_without_a_warning": (ONE,),
        "test_spec_round_trip_makes_the_same_environment": (ONE,),
        "test_equal_seeds_give_equal_trajectories": (ONE,),
        "test_a_pickled_environment_continues_where_it_was": (ONE,),
    },
    "flexarm_env/test_nonsense.py": {
        "test_rewards_are_finite_whatever_the_torque": ("One",),
    },
}


def left_to_night(file: str, test: str, name: str) -> bool:
    """Whether a test of this function and name, with its parameters, waits for the night."""
    by_day = NIGHT.get(file, {}).get(test)
    return by_day is not None and not any(part in name for part in by_day)
