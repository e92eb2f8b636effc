"""Callbacks, loggers, and an algorithm; most of them fail in one way."""

import json
from pathlib import Path

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter


class ExploreLess(BaseCallback):
    """Lowers the weight of the entropy over the first 10,000 steps, notes the norm of the weights every 25
    calls, and saves the model."""

    def _on_training_end(self):
        self.model.save(Path(self.logger.dir).parent / "logs" / "whole")

    def _on_step(self):
        self.model.ent_coef = 0.01 * max(0.0, 1.0 - self.num_timesteps / 10_000)
        if self.n_calls % 25 == 0:
            self.logger.record(
                "acme/norm", sum(float(p.detach().norm()) for p in self.model.policy.parameters())
            )
        return True


class JsonLines(KVWriter):
    """A line of JSON for each time that the training logs."""

    def __init__(self, run):
        (run / "logs").mkdir(exist_ok=True)
        self.file = (run / "logs" / "scalars.jsonl").open("a")

    def write(self, key_values, key_excluded, step=0):
        numbers = {name: float(value) for name, value in key_values.items() if not name.startswith("time/")}
        self.file.write(json.dumps({"steps": step, **numbers}) + "\n")
        self.file.flush()

    def close(self):
        self.file.close()


class Impatient(BaseCallback):
    """Ends the training after 100 steps."""

    def _on_step(self):
        return self.num_timesteps < 100


class Failing(BaseCallback):
    """Fails after 100 steps."""

    def _on_step(self):
        if self.num_timesteps >= 100:
            raise KeyError("no such gauge")
        return True


def no_callback():
    """Makes something else."""
    return "a text"


class FullDisk(KVWriter):
    """Cannot write."""

    def __init__(self, run):
        pass

    def write(self, key_values, key_excluded, step=0):
        raise OSError(28, "No space left on device")

    def close(self):
        pass


class Elsewhere(PPO):
    """Names no tensors to store, as the algorithms of sbx."""

    def _get_torch_save_params(self):
        return [], []
