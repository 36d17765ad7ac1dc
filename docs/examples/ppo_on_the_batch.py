"""PPO in one file, on the batched environment, in the manner of CleanRL.

All nets of all copies of a problem move in every step and share one policy: independent PPO. A task
is an episode of its agent. What differs from a usual PPO loop is marked with ``#!``.
"""

import time
from itertools import pairwise

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import marouting
from marouting.vector import BatchEnv

COPIES, STEPS, UPDATES = 8, 64, 25  # games side by side, steps of a rollout, rollouts
EPOCHS, MINIBATCH, RATE = 4, 2048, 2e-3
GAMMA, LAMBDA, CLIP, ENTROPY, SCALE = 0.95, 0.9, 0.2, 0.01, 0.05  # SCALE: of rewards

torch.manual_seed(0)
torch.set_num_threads(1)
rng = np.random.default_rng(0)
problem = marouting.generate(1, grid=(8, 8, 2), nets=20, seed=1, reduced_edges=0)[0]
env = BatchEnv([problem] * COPIES)
JOINED, FAILED = 1, 2  # in info["task_ended"]


def layers(outputs, gain):
    """Two hidden layers of 64."""
    sizes = [env.single_observation_space.shape[0], 64, 64, outputs]
    made = []
    for inputs, units in pairwise(sizes):
        made += [nn.Linear(inputs, units), nn.Tanh()]
        nn.init.orthogonal_(made[-2].weight, np.sqrt(2))
    nn.init.orthogonal_(made[-2].weight, gain)
    return nn.Sequential(*made[:-1])


actor, critic = layers(6, 0.01), layers(1, 1.0)
optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=RATE, eps=1e-5)


def policy(obs, mask):
    """The distribution of moves, among those that cross an edge."""
    return Categorical(logits=actor(obs / 8).masked_fill(mask == 0, -1e9))


def value(obs):
    """What the critic expects."""
    return critic(obs / 8).squeeze(-1)


started, moves, shares = time.perf_counter(), 0, []
obs, info = env.reset()
for update in range(UPDATES):
    rows = []
    joined = ended = 0
    with torch.no_grad():
        for _ in range(STEPS):
            # The environment's arrays are written over by the next step.
            seen, mask = torch.tensor(obs), torch.tensor(info["action_mask"])
            moving = policy(seen, mask)
            action = moving.sample()
            obs, reward, _, _, info = env.step(action.numpy())
            ending = torch.tensor(info["task_ended"])
            #! Where a task ended, `obs` shows the next; `final_obs` is where the agent arrived.
            after = np.where((ending > 0)[..., None], info["final_obs"], obs)
            rows.append({
                "obs": seen, "mask": mask, "action": action, "logp": moving.log_prob(action),
                "value": value(seen), "next": value(torch.from_numpy(after)), "ending": ending,
                "reward": SCALE * torch.tensor(reward), "acted": torch.tensor(info["acted"]),
            })  # fmt: skip
            joined, ended = joined + int((ending == JOINED).sum()), ended + int((ending > 0).sum())
    batch = {name: torch.stack([row[name] for row in rows]) for name in rows[0]}

    advantage, gae = torch.zeros_like(batch["reward"]), torch.zeros_like(batch["reward"][0])
    for t in reversed(range(STEPS)):
        #! A joined task ends the sum of rewards; a failed one only ran out of steps.
        bootstrap = (batch["ending"][t] != JOINED).float()
        delta = batch["reward"][t] + GAMMA * bootstrap * batch["next"][t] - batch["value"][t]
        gae = delta + GAMMA * LAMBDA * (batch["ending"][t] == 0).float() * gae
        advantage[t] = gae
    batch["advantage"], batch["return"] = advantage, advantage + batch["value"]
    #! Rows of agents that were done, or absent, are no transitions.
    batch = {name: array[batch["acted"]] for name, array in batch.items()}

    count = len(batch["obs"])
    moves += count
    for _ in range(EPOCHS):
        for part in torch.from_numpy(rng.permutation(count)).split(MINIBATCH):
            b = {name: array[part] for name, array in batch.items()}
            moving = policy(b["obs"], b["mask"])
            ratio = (moving.log_prob(b["action"]) - b["logp"]).exp()
            gain = (b["advantage"] - b["advantage"].mean()) / (b["advantage"].std() + 1e-8)
            clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
            loss = -torch.min(ratio * gain, clipped * gain) - ENTROPY * moving.entropy()
            loss = (loss + 0.5 * (value(b["obs"]) - b["return"]).square()).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], 0.5)
            optimiser.step()
    shares.append(joined / ended)
    if update % 5 == 0 or update == UPDATES - 1:
        print(f"update {update:2}: {moves:7} moves, {100 * shares[-1]:3.0f} % of tasks joined")

astar = marouting.evaluate(problem, marouting.sequential_astar(problem))
print(f"{moves / (time.perf_counter() - started):.0f} moves per second, learning included")
print(f"joined: {shares[0]:.2f} -> {shares[-1]:.2f}")
print(f"wirelength: {info['final_info']['wirelength'].mean():.0f} (A*: {astar.wirelength})")
