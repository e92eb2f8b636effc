"""Independent PPO for several agents, over an environment of PettingZoo: each agent has a policy of its own.

C. Schroeder de Witt et al., Is independent learning all you need in the StarCraft multi-agent challenge?,
arXiv:2011.09533, 2020.
"""

import time

import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import deepbots_cli


class Learner:
    """The policy and the experience of one agent, with continuous actions."""

    def __init__(self, inputs: int, outputs: int, gamma: float = 0.98, learning_rate: float = 1e-3) -> None:
        self.actor = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, outputs))
        self.critic = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 1))
        self.log_std = nn.Parameter(torch.full((outputs,), -0.5))
        self.parameters = [*self.actor.parameters(), *self.critic.parameters(), self.log_std]
        self.optimizer = torch.optim.Adam(self.parameters, lr=learning_rate)
        self.gamma, self.steps = gamma, []

    def act(self, observation: np.ndarray) -> np.ndarray:
        """Sample an action."""
        seen = torch.as_tensor(observation)
        with torch.no_grad():
            choice = Normal(self.actor(seen), self.log_std.exp())
            action = choice.sample()
            self.last = seen, action, choice.log_prob(action).sum(), self.critic(seen)[0]
        return action.clamp(-1.0, 1.0).numpy()

    def keep(self, reward: float, following: np.ndarray, terminated: bool, ended: bool) -> None:
        """Keep the last step. An episode that a time limit ends would have gone on."""
        if ended and not terminated:
            with torch.no_grad():
                reward += self.gamma * float(self.critic(torch.as_tensor(following)))
        self.steps.append((*self.last, reward, float(ended)))

    def learn(self, observation: np.ndarray, clip: float = 0.2, gae_lambda: float = 0.95) -> None:
        """Learn from all kept steps; `observation` is the one after them."""
        seen, taken, old, values, rewards, ends = (
            torch.stack([torch.as_tensor(part, dtype=torch.float32) for part in column])
            for column in zip(*self.steps, strict=True)
        )
        self.steps.clear()
        advantages, advantage = torch.zeros_like(values), torch.tensor(0.0)
        with torch.no_grad():
            following = self.critic(torch.as_tensor(observation))[0]
        for step in reversed(range(len(values))):
            goes_on = 1.0 - ends[step]
            error = rewards[step] + self.gamma * goes_on * following - values[step]
            advantages[step] = advantage = error + self.gamma * gae_lambda * goes_on * advantage
            following = values[step]
        targets, weights = advantages + values, (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        for _ in range(8):
            for batch in torch.randperm(len(seen)).split(256):
                log_probs = Normal(self.actor(seen[batch]), self.log_std.exp()).log_prob(taken[batch]).sum(-1)
                ratio = (log_probs - old[batch]).exp()
                gains = torch.min(
                    weights[batch] * ratio, weights[batch] * ratio.clamp(1.0 - clip, 1.0 + clip)
                )
                errors = (self.critic(seen[batch]).flatten() - targets[batch]).square()
                self.optimizer.zero_grad()
                (0.5 * errors.mean() - gains.mean()).backward()
                nn.utils.clip_grad_norm_(self.parameters, 0.5)
                self.optimizer.step()


def main(
    scenario: str = "carry", cpu_seconds: float = 60.0, rollout: int = 2048, seed: int = 0
) -> list[float]:
    """Train all agents of a scenario, and return the returns of the episodes, summed over the agents."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    env = deepbots_cli.parallel_env(scenario)
    learners = {
        name: Learner(env.observation_space(name).shape[0], env.action_space(name).shape[0])
        for name in env.possible_agents
    }
    observations, _ = env.reset(seed=seed)
    began, returns, total = time.process_time(), [], 0.0
    while time.process_time() - began < cpu_seconds:
        for _ in range(rollout):
            actions = {name: learner.act(observations[name]) for name, learner in learners.items()}
            observations, rewards, terminations, truncations, _ = env.step(actions)
            for name, learner in learners.items():
                ended = terminations[name] or truncations[name]
                learner.keep(rewards[name], observations[name], terminations[name], ended)
            total += sum(rewards.values())
            if not env.agents:
                observations, _ = env.reset()
                returns.append(total)
                total = 0.0
        for name, learner in learners.items():
            learner.learn(observations[name])
        if returns:
            print(f"{len(returns):,} episodes: mean return of all agents {np.mean(returns[-50:]):.2f}")
    env.close()
    return returns


if __name__ == "__main__":
    main()
