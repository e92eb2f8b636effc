"""Stable-Baselines3 by hand: its algorithm, its wrappers and its callbacks on an environment of deepbots."""

from functools import partial

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import deepbots_cli


def main(total_timesteps: int = 40_000, folder: str | None = None) -> float:
    """Train on the CartPole, and return the mean return of ten episodes; models and evaluations go to
    `folder`."""
    make = partial(deepbots_cli.make, "cartpole")
    envs = VecMonitor(DummyVecEnv([make] * 4))
    evaluation = EvalCallback(
        VecMonitor(DummyVecEnv([make])),
        eval_freq=2_000,
        n_eval_episodes=5,
        best_model_save_path=folder,
        log_path=folder,
        verbose=0,
    )
    model = PPO(
        "MlpPolicy", envs, n_steps=64, batch_size=64, learning_rate=3e-3, gae_lambda=0.9, seed=0, device="cpu"
    )
    model.learn(total_timesteps, callback=evaluation)
    env = Monitor(make())
    score, _ = evaluate_policy(model, env, n_eval_episodes=10)
    for world in (env, envs, evaluation.eval_env):
        world.close()
    print(f"mean return {score:.1f}")
    return float(score)


if __name__ == "__main__":
    main()
