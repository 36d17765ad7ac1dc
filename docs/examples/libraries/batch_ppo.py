"""PPO in one file on the batch, in the manner of CleanRL: all nets of all games share a policy."""

import torch
from curve import Curve
from torch.distributions import Categorical

from marouting import scenarios
from marouting.vector import BatchEnv

torch.set_num_threads(1)
curve = Curve(steps=200_000)
torch.manual_seed(curve.seed)
problem = scenarios.get("toy-4x4-v0").test[0]
options = {"reward": "normalised", "max_steps": 20}
env, test = BatchEnv([problem] * 32, **options), BatchEnv([problem], **options)
network = torch.nn.Sequential(torch.nn.Linear(12, 128), torch.nn.ReLU(), torch.nn.Linear(128, 7))
adam = torch.optim.Adam(network.parameters(), lr=1e-3)


def told(obs, mask):
    """The moves that cross an edge, by six logits, and the value."""
    out, free = network(torch.as_tensor(obs)), torch.as_tensor(mask) > 0
    return Categorical(logits=out[..., :6].where(free, -1e9)), out[..., 6]


def joined():
    """The share of the nets that the policy joins without exploration."""
    obs, info = test.reset()
    while info["active"].any():
        obs, *_, info = test.step(told(obs, info["action_mask"])[0].logits.argmax(-1).numpy())
    return float(info["joined"][0] / test.num_agents)


(obs, info), steps, going, rows = env.reset(), 0, True, []
while going:
    seen, mask = torch.tensor(obs), torch.tensor(info["action_mask"])  # copies
    with torch.no_grad():
        choice, value = told(seen, mask)
        obs, paid, *_, info = env.step((move := choice.sample()).numpy())
        end, acted, last = (torch.tensor(info[k]) for k in ("task_ended", "acted", "final_obs"))
        after = last.where((end > 0)[..., None], torch.tensor(obs))  # not the next task
        aim = torch.tensor(paid) + 0.95 * (end != 1) * told(after, mask)[1]  # 1: joined
    rows.append((seen, mask, move, choice.log_prob(move), value, aim, acted, end > 0))
    if len(rows) < 32:
        continue
    *data, value, aim, acted, end = map(torch.stack, zip(*rows, strict=True))
    gain, gains, rows = 0, torch.zeros_like(value), []
    for t in reversed(range(32)):
        gains[t] = gain = aim[t] - value[t] + 0.95 * 0.9 * ~end[t] * gain
    data, steps = [x[acted] for x in (*data, gains, value + gains)], steps + int(acted.sum())
    for part in (p for _ in range(8) for p in torch.randperm(len(data[0])).split(640)):
        o, free, m, c, g, r = (x[part] for x in data)
        choice, value = told(o, free)
        ratio, g = (choice.log_prob(m) - c).exp(), (g - g.mean()) / (g.std() + 1e-8)
        loss = (value - r).square().mean() / 2 - 0.03 * choice.entropy().mean()
        adam.zero_grad()
        (loss - torch.min(ratio * g, ratio.clip(0.8, 1.2) * g).mean()).backward()
        adam.step()
    going = curve.row(steps, joined())
curve.end()
