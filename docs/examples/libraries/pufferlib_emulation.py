"""PPO written out on PufferLib's emulation and vector: ``pip install pufferlib-core==3.0.19``."""

from functools import partial

import numpy as np
import torch
from curve import Curve
from pufferlib import emulation, vector
from torch import nn
from torch.distributions import Categorical

from marouting import global_routing_v0, scenarios

torch.set_num_threads(1)
curve = Curve(steps=400_000)
torch.manual_seed(curve.seed)
options = {"reward": "normalised", "max_steps": 20, "agents_persist": True}
make = partial(global_routing_v0.parallel_env, scenarios.get("toy-4x4-v0").test[0], **options)
emulated = partial(emulation.PettingZooPufferEnv, env_creator=make)
env = vector.make(emulated, backend=vector.Serial, num_envs=8)
test, hidden = make(), [nn.Linear(12, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU()]
network = nn.Sequential(*hidden, nn.Linear(128, 7))  # six logits and a value
adam = torch.optim.Adam(network.parameters(), lr=1e-3)


def joined():
    """The share of the nets that the policy joins without exploration."""
    seen, _ = test.reset()
    while test.agents:
        moves = network(torch.tensor(np.stack(list(seen.values()))))[:, :6].argmax(-1).tolist()
        seen, *_ = test.step(dict(zip(test.agents, moves, strict=True)))
    return test.metrics()["joined"] / test.metrics()["tasks"]


(seen, _), steps, going, rows = env.reset(seed=curve.seed), 0, True, []
while going:
    before = torch.tensor(seen)
    with torch.no_grad():
        value, choice = (told := network(before))[:, 6], Categorical(logits=told[:, :6])
    seen, paid, ended, cut, _ = env.step((move := choice.sample()).numpy())
    rest = torch.tensor(paid), torch.tensor(ended | cut).float()
    rows.append((before, move, choice.log_prob(move), value, *rest))
    if len(rows) < 65:
        continue
    obs, moves, chance, values, paid, over = map(torch.stack, zip(*rows, strict=True))
    gain, gains = 0, torch.zeros(64, env.num_agents)
    for t in reversed(range(64)):
        gains[t] = gain = paid[t] - values[t] + 0.95 * (1 - over[t]) * (values[t + 1] + 0.9 * gain)
    rows, steps = rows[-1:], steps + gains.numel()
    data = [x[:64].flatten(0, 1) for x in (obs, moves, chance, gains, values[:64] + gains)]
    for part in (p for _ in range(8) for p in torch.randperm(gains.numel()).split(640)):
        o, m, c, g, r = (x[part] for x in data)
        choice, value = Categorical(logits=(told := network(o))[:, :6]), told[:, 6]
        ratio, g = (choice.log_prob(m) - c).exp(), (g - g.mean()) / (g.std() + 1e-8)
        loss = (value - r).square().mean() / 2 - 0.03 * choice.entropy().mean()
        adam.zero_grad()
        (loss - torch.min(ratio * g, ratio.clip(0.8, 1.2) * g).mean()).backward()
        adam.step()
    going = curve.row(steps, joined())
curve.end()
