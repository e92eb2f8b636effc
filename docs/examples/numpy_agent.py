"""A linear policy for the CartPole in plain NumPy, found by the cross-entropy method.

R. Rubinstein, The cross-entropy method for combinatorial and continuous optimization, 1999.
"""

import gymnasium
import numpy as np

import deepbots_cli


def episode(env: gymnasium.Env, weights: np.ndarray, seed: int) -> float:
    """The return of an episode; the cart drives forward (0) where the weighted sum of the observation is
    positive."""
    observation, _ = env.reset(seed=seed)
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(int(weights @ observation <= 0.0))
        total += float(reward)
        over = terminated or truncated
    return total


def main(generations: int = 8, candidates: int = 24, elite: int = 6) -> float:
    """Search, and return the mean return of the mean weights over ten new starts."""
    generator = np.random.default_rng(0)
    env = deepbots_cli.make("cartpole")
    size = env.observation_space.shape[0]
    mean, std = np.zeros(size), np.ones(size)
    for generation in range(generations):
        population = mean + std * generator.standard_normal((candidates, size))
        returns = np.array([episode(env, weights, seed=generation) for weights in population])
        best = population[np.argsort(returns)[-elite:]]
        mean, std = best.mean(axis=0), best.std(axis=0) + 0.05
        print(f"generation {generation + 1}: mean return {returns.mean():.1f}, best {returns.max():.1f}")
    score = float(np.mean([episode(env, mean, seed=1000 + k) for k in range(10)]))
    env.close()
    print(f"the mean weights {np.round(mean, 2)} reach a mean return of {score:.1f}")
    return score


if __name__ == "__main__":
    main()
