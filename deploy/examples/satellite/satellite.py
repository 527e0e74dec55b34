"""A satellite that turns to its target, in JAX: many rollouts in one call, on a CPU or a GPU."""

from functools import partial

import jax
import jax.numpy as jnp

import perfbound as pb

jax.config.update("jax_enable_x64", True)
INERTIA = jnp.array([120.0, 100.0, 80.0])  # kg m2
TORQUE, STEP = 0.5, 0.1  # N m of each wheel at most, and s


def derivative(state, torque):
    """Return the change of quaternion and rates, by Euler's equations."""
    q, w = state[:4], state[4:]
    turn = jnp.concatenate([-(q[1:] @ w)[jnp.newaxis], q[0] * w + jnp.cross(q[1:], w)])
    return jnp.concatenate([turn / 2, (torque - jnp.cross(w, INERTIA * w)) / INERTIA])


def advance(state, noise):
    """Return the state after a step of Runge and Kutta, and the columns before it."""
    q, w = state[:4], state[4:]
    torque = jnp.clip(-4.0 * jnp.sign(q[0]) * (q[1:] + noise) - 40.0 * w, -TORQUE, TORQUE)
    a = derivative(state, torque)
    b = derivative(state + STEP / 2 * a, torque)
    c = derivative(state + STEP / 2 * b, torque)
    d = derivative(state + STEP * c, torque)
    after = state + STEP / 6 * (a + 2 * b + 2 * c + d)
    error = 2 * jnp.atan2(jnp.linalg.norm(q[1:]), jnp.abs(q[0]))
    return after.at[:4].divide(jnp.linalg.norm(after[:4])), jnp.rad2deg(jnp.stack([error, jnp.linalg.norm(w)]))


@partial(jax.jit, static_argnums=3)
@partial(jax.vmap, in_axes=(0, 0, 0, None, None))
def turned(angle, rate, seed, samples, noise):
    """Return the columns of one rollout, shape (samples, 2)."""
    half, rates = jnp.deg2rad(angle) / 2, jnp.deg2rad(rate) * jnp.array([0.0, 1.0, 1.0])
    start = jnp.concatenate([jnp.array([jnp.cos(half), jnp.sin(half), 0.0, 0.0]), rates])
    noises = noise * jax.random.normal(jax.random.key(seed), (samples, 3))
    return jax.lax.scan(advance, start, noises)[1]


@pb.system(
    parameters={"angle": pb.Parameter(0, 180, unit="deg"), "rate": pb.Parameter(-2, 2, unit="deg/s")},
    columns={"error": "deg", "rate": "deg/s"},
    step=STEP,
    versions={"jax": jax.__version__},
    vectorised=True,
    batch_is_the_unit=True,  # XLA compiles each size of a batch anew, and may add in another order
)
def satellite(angle, rate, *, seeds, horizon, noise=0.01):
    """Turn a tumbling satellite to its target by three wheels, with a star tracker that is noisy."""
    return turned(angle, rate, seeds, round(horizon / STEP) + 1, noise)
