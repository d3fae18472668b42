"""Gymnasium environments: `lpvmpc/Track-v0`, one car, and `lpvmpc/TrackVec-v0`, many at once.

    import gymnasium, lpvmpc.gym
    env = gymnasium.make("lpvmpc/Track-v0", worlds=["rtk"])
    cars = gymnasium.make_vec("lpvmpc/TrackVec-v0", num_envs=64)

Where lpvmpc is installed, gymnasium registers them by itself (entry point `gymnasium.envs`); only
names are registered, and nothing of the simulator is imported before an environment is made.
"""


def register() -> None:
    """Make the two environments known to gymnasium; a second call changes nothing."""
    from gymnasium import registry
    from gymnasium.envs.registration import register as known

    if "lpvmpc/Track-v0" not in registry:
        known("lpvmpc/Track-v0", entry_point="lpvmpc.gym.track:TrackEnv",
              vector_entry_point="lpvmpc.gym.track_vec:TrackVecEnv")
    if "lpvmpc/TrackVec-v0" not in registry:
        known("lpvmpc/TrackVec-v0", entry_point=None,
              vector_entry_point="lpvmpc.gym.track_vec:TrackVecEnv")


try:
    register()
except ModuleNotFoundError as error:
    if error.name != "gymnasium":
        raise
