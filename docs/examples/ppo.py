"""PPO in one file, in the style of CleanRL: all of the algorithm in one function, from top to bottom.

J. Schulman et al., Proximal policy optimization algorithms, arXiv:1707.06347, 2017.
"""

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import deepbots_cli

gymnasium.register_envs(deepbots_cli)


def main(total_timesteps: int = 60_000, copies: int = 4, steps: int = 128, seed: int = 0) -> list[float]:
    """Train on the CartPole, and return the returns of the episodes in order."""
    gamma, gae_lambda, clip, epochs, batch_size, learning_rate = 0.99, 0.95, 0.2, 10, 64, 2.5e-3
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(
        "deepbots/CartPole-v1",
        num_envs=copies,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP},
    )
    inputs, options = envs.single_observation_space.shape[0], int(envs.single_action_space.n)
    actor = nn.Sequential(
        nn.Linear(inputs, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, options)
    )
    critic = nn.Sequential(nn.Linear(inputs, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, 1))
    parameters = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(parameters, lr=learning_rate, eps=1e-5)

    # Storage of a rollout, of shape (steps, copies).
    observations = torch.zeros(steps, copies, inputs)
    actions, log_probs, rewards, dones, values = (torch.zeros(steps, copies) for _ in range(5))
    observation = torch.as_tensor(envs.reset(seed=seed)[0])
    running, returns = np.zeros(copies), []

    for update in range(total_timesteps // (steps * copies)):
        for step in range(steps):
            with torch.no_grad():
                choice = Categorical(logits=actor(observation))
                action = choice.sample()
                values[step] = critic(observation).flatten()
            observations[step], actions[step], log_probs[step] = observation, action, choice.log_prob(action)
            following, reward, terminated, truncated, info = envs.step(action.numpy())
            done = terminated | truncated
            reward = np.array(reward, dtype=np.float64)
            running += reward
            returns += running[done].tolist()
            running[done] = 0.0
            if truncated.any():  # an episode that a time limit ends would have gone on
                with torch.no_grad():
                    last = torch.as_tensor(np.stack(list(info["final_obs"][truncated])))
                    reward[truncated] += gamma * critic(last).flatten().numpy()
            rewards[step], dones[step] = torch.as_tensor(reward), torch.as_tensor(done)
            observation = torch.as_tensor(following)

        # Generalized advantage estimation.
        advantages, advantage = torch.zeros(steps, copies), torch.zeros(copies)
        with torch.no_grad():
            following_value = critic(observation).flatten()
        for step in reversed(range(steps)):
            goes_on = 1.0 - dones[step]
            error = rewards[step] + gamma * goes_on * following_value - values[step]
            advantage = error + gamma * gae_lambda * goes_on * advantage
            advantages[step], following_value = advantage, values[step]
        targets = (advantages + values).flatten()

        rows = observations.reshape(-1, inputs), actions.flatten(), log_probs.flatten(), advantages.flatten()
        for _ in range(epochs):
            for batch in torch.randperm(steps * copies).split(batch_size):
                seen, taken, old, weight = (part[batch] for part in rows)
                choice = Categorical(logits=actor(seen))
                ratio = (choice.log_prob(taken) - old).exp()
                weight = (weight - weight.mean()) / (weight.std() + 1e-8)
                policy_loss = -torch.min(weight * ratio, weight * ratio.clamp(1.0 - clip, 1.0 + clip)).mean()
                value_loss = (critic(seen).flatten() - targets[batch]).square().mean()
                optimizer.zero_grad()
                (policy_loss + 0.5 * value_loss).backward()
                nn.utils.clip_grad_norm_(parameters, 0.5)
                optimizer.step()
        if update % 10 == 0 and returns:
            print(f"{(update + 1) * steps * copies:,} steps: mean return {np.mean(returns[-50:]):.1f}")
    envs.close()
    return returns


if __name__ == "__main__":
    main()
