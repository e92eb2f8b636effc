"""A loop over several copies of an environment in Gymnasium's vector API, here with random actions."""

import gymnasium
import numpy as np

import deepbots_cli

gymnasium.register_envs(deepbots_cli)


def main(steps: int = 500, copies: int = 4) -> dict[str, int]:
    """Step the copies, and return how many episodes each ending has ended."""
    envs = gymnasium.make_vec(
        "deepbots/FindBall-v1",
        num_envs=copies,
        # "async" runs each copy in a process of its own, for worlds whose steps take milliseconds
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP},
    )
    envs.action_space.seed(0)
    envs.reset(seed=0)  # copy k gets the seed k
    returns, endings = np.zeros(copies), {}
    for _ in range(steps):
        _, rewards, terminated, truncated, infos = envs.step(envs.action_space.sample())
        returns += rewards
        for copy in np.flatnonzero(terminated | truncated):
            ending = str(infos["final_info"]["ended_by"][copy])
            print(f"copy {copy}: {ending}, return {returns[copy]:.2f}")
            endings[ending] = endings.get(ending, 0) + 1
            returns[copy] = 0.0
    envs.close()
    return endings


if __name__ == "__main__":
    main()
