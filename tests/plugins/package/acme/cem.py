"""A learner of its own: the cross-entropy method for one choice, in numpy (R. Y. Rubinstein, 1999)."""

import numpy as np

from deepbots_cli.learning.learner import ArrayLearner
from deepbots_cli.rollout.collector import Decision


def with_one(observations):
    return np.concatenate([observations, np.ones((*observations.shape[:-1], 1))], axis=-1)


class CrossEntropyMethod(ArrayLearner):
    """Each episode tries a linear policy; the best quarter of a population says where the next ones are
    drawn."""

    def __init__(self, setup):
        super().__init__(setup)
        (population,) = (
            entry.value for entry in setup.training.hyperparameters if entry.name == "population"
        )
        self.shape = setup.action_space.n, setup.observation_space.shape[0] + 1
        self.mean = np.zeros(self.shape)
        self.spread = np.ones(self.shape)
        self.tried, self.scores = np.zeros((population, *self.shape)), np.zeros(population)
        self.acting = np.zeros((setup.collector.rows if setup.collector else 1, *self.shape))
        self.drawn, self.finished = np.zeros(1, int), np.zeros(1, int)

    def weights(self):
        return {"mean": self.mean}

    def memory(self):
        return {
            name: getattr(self, name) for name in ("spread", "tried", "scores", "acting", "drawn", "finished")
        }

    def act(self, observations, starts, masks):
        for row in np.flatnonzero(starts):
            noise = np.random.default_rng([self.setup.seed, self.drawn[0]]).standard_normal(self.shape)
            self.acting[row] = self.mean + self.spread * noise
            self.drawn += 1
        preferences = np.einsum("rak,rk->ra", self.acting, with_one(observations))
        return Decision(preferences.argmax(axis=1), {"policies": self.acting.copy()})

    def update(self):
        for step, ending in self.fragment.endings:
            self.tried[self.finished[0]] = self.fragment.columns["policies"][step, ending.row]
            self.scores[self.finished[0]] = ending.episode.total_return
            self.finished += 1
            if self.finished[0] == len(self.scores):
                best = self.tried[np.argsort(-self.scores, kind="stable")[: len(self.scores) // 4]]
                self.mean[...] = best.mean(axis=0)
                self.spread[...] = best.std(axis=0) + 0.1
                self.finished[...] = 0
                self.log.record("cem/best_return", self.scores.max())

    def predict(self, observation, state=None, episode_start=None, deterministic=False, action_masks=None):
        return (with_one(observation) @ self.mean.T).argmax(axis=-1), None
