"""A pole on a cart, in MuJoCo."""

import mujoco
import numpy as np

import perfbound as pb

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco>
  <option timestep="0.02" integrator="implicitfast"/>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0" damping="0.1"/>
      <geom type="box" size="0.2 0.1 0.05" mass="1"/>
      <body>
        <joint name="pivot" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 1" size="0.03" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="rail" ctrlrange="-10 10"/></actuator>
</mujoco>""")
DATA = mujoco.MjData(MODEL)
GAINS = np.array([2.8, 40, 4.2, 9.6])  # N per unit of each column, from an LQR


@pb.system(
    parameters={"angle": pb.Parameter(-0.5, 0.5, unit="rad"), "rate": pb.Parameter(-2, 2, unit="rad/s")},
    columns={"position": "m", "angle": "rad", "speed": "m/s", "rate": "rad/s"},
    step=0.02,
    versions={"mujoco": mujoco.__version__},
)
def cartpole(angle, rate, *, seed, horizon, gusts=0.1):
    """Hold a pole upright on a cart by a state feedback, while gusts push the pole."""
    mujoco.mj_resetData(MODEL, DATA)  # everything of the last rollout, also the warm start of the solver
    DATA.qpos[1], DATA.qvel[1] = angle, rate
    states = np.empty((round(horizon / 0.02) + 1, 4))
    for state, gust in zip(states, np.random.default_rng(seed).normal(0, gusts, len(states)), strict=True):
        state[:] = *DATA.qpos, *DATA.qvel
        DATA.ctrl[0], DATA.qfrc_applied[1] = GAINS @ state, gust
        mujoco.mj_step(MODEL, DATA)
    return states
