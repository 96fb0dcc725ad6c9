"""The profile of a training, part by part."""

from dataclasses import replace

import torch

from agents.config import load_config
from benchmarks.training.learning import CONFIG, REST, profiled


def test_every_part_of_a_training_takes_its_time() -> None:
    config = replace(load_config(CONFIG), total_steps=16_384)
    backward, threads = torch.Tensor.backward, torch.get_num_threads()
    try:
        found = profiled(config, 1)
    finally:
        torch.set_num_threads(threads)
    assert torch.Tensor.backward is backward
    assert min(found.values()) > 0.0
    assert len(found) == 7
    assert found[REST] < 0.5 * found["whole"]
