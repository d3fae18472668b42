"""The car as a gymnasium environment, driven at random: how far does chance come?

    python examples/gym_random.py        (needs `pip install 'lpvmpc[gym]'`)

Each episode draws its road, its start and, in the world `fleet`, its car, friction and slopes.
docs/gymnasium.md says what is seen, done and rewarded.
"""

import gymnasium

import lpvmpc.gym  # noqa: F401  (an installed lpvmpc needs no import: gymnasium finds it)

if __name__ == "__main__":
    env = gymnasium.make("lpvmpc/Track-v0", worlds=["fleet"], roads=["random-1", "random-2"])
    env.action_space.seed(0)
    for episode in range(3):
        _, info = env.reset(seed=episode)
        start, total, over = info["s"], 0.0, False
        while not over:
            _, reward, lost, ended, info = env.step(env.action_space.sample())
            total, over = total + reward, lost or ended
        print(f"{info['road']}: {info['s'] - start:5.1f} m, reward {total:6.1f},",
              "lost" if lost else "not lost")
