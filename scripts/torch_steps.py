#!/usr/bin/env python3
"""Times a training step of the same networks in PyTorch, for scripts/compare-with-torch.sh.

Both halves of a pose VQ-VAE (width 256, 32 x 240 frames) and a motion GPT (6 blocks of 256 channels,
32 x 29 codes), float32, with Adam. Prints one JSON object.
"""

import argparse
import json
import time

import torch
from torch import nn
from torch.nn import functional


class Residual(nn.Module):
    def __init__(self, width, dilation):
        super().__init__()
        self.dilated = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.pointwise = nn.Conv1d(width, width, 1)

    def forward(self, hidden):
        wide = self.dilated(functional.relu(hidden))
        return hidden + self.pointwise(functional.relu(wide))


def stack(width, dilations):
    return [Residual(width, dilation) for dilation in dilations]


class Half(nn.Module):
    def __init__(self, columns, width, codes):
        super().__init__()
        encoder = []
        for level in range(3):
            encoder.append(nn.Conv1d(width if level else columns, width, 4, 2, 1))
            encoder += stack(width, (1, 3, 9))
        encoder.append(nn.Conv1d(width, width, 3, padding=1))
        decoder = [nn.Conv1d(width, width, 3, padding=1)]
        for _ in range(3):
            decoder += stack(width, (9, 3, 1))
            decoder.append(nn.ConvTranspose1d(width, width, 4, 2, 1))
        decoder.append(nn.Conv1d(width, columns, 3, padding=1))
        self.encoder = nn.Sequential(*encoder)
        self.decoder = nn.Sequential(*decoder)
        self.register_buffer("entries", torch.randn(codes, width))
        self.register_buffer("sums", self.entries.clone())
        self.register_buffer("counts", torch.ones(codes))

    def loss(self, motion):
        encoded = self.encoder(motion)
        vectors = encoded.detach().transpose(1, 2).reshape(-1, encoded.shape[1])
        distances = (self.entries**2).sum(1) - 2 * vectors @ self.entries.t()
        indices = distances.argmin(1)
        quantised = self.entries[indices].view(encoded.shape[0], -1, encoded.shape[1]).transpose(1, 2)
        with torch.no_grad():
            assigned = functional.one_hot(indices, len(self.entries)).float()
            self.counts.mul_(0.99).add_(assigned.sum(0), alpha=0.01)
            self.sums.mul_(0.99).add_(assigned.t() @ vectors, alpha=0.01)
            self.entries.copy_(self.sums / self.counts.clamp_min(1e-3)[:, None])
        commitment = ((encoded - quantised) ** 2).mean()
        error = self.decoder(encoded + (quantised - encoded).detach()) - motion
        first = error[:, :, 1:] - error[:, :, :-1]
        second = first[:, :, 1:] - first[:, :, :-1]
        return error.abs().mean() + first.abs().mean() + second.abs().mean() + 0.02 * commitment


class Block(nn.Module):
    def __init__(self, channels, heads, dropout):
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.norm1, self.norm2 = nn.LayerNorm(channels), nn.LayerNorm(channels)
        self.query, self.key = nn.Linear(channels, channels), nn.Linear(channels, channels)
        self.value, self.output = nn.Linear(channels, channels), nn.Linear(channels, channels)
        self.wide, self.narrow = nn.Linear(channels, 4 * channels), nn.Linear(4 * channels, channels)

    def forward(self, hidden, mask):
        batch, length, channels = hidden.shape
        normed = self.norm1(hidden)
        split = lambda part: part(normed).view(batch, length, self.heads, -1).transpose(1, 2)
        mixed = functional.scaled_dot_product_attention(
            split(self.query), split(self.key), split(self.value), mask, self.dropout
        )
        mixed = mixed.transpose(1, 2).reshape(batch, length, channels)
        hidden = hidden + functional.dropout(self.output(mixed), self.dropout)
        wide = self.narrow(functional.gelu(self.wide(self.norm2(hidden))))
        return hidden + functional.dropout(wide, self.dropout)


class Gpt(nn.Module):
    def __init__(self, channels, heads, layers, block, codes, columns, dropout):
        super().__init__()
        self.block, self.dropout = block, dropout
        self.music = nn.Linear(columns, channels)
        self.embeddings = nn.ModuleList(nn.Embedding(codes, channels) for _ in range(2))
        self.positions = nn.Parameter(torch.zeros(1, 3 * block, channels))
        self.blocks = nn.ModuleList(Block(channels, heads, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(channels)
        self.maps = nn.ModuleList(nn.Linear(channels, codes, bias=False) for _ in range(2))
        allowed = torch.ones(block, block).tril().bool().repeat(3, 3)
        self.register_buffer("mask", allowed)

    def loss(self, music, codes, targets):
        parts = [self.music(music), *(table(c) for table, c in zip(self.embeddings, codes))]
        hidden = functional.dropout(torch.cat(parts, 1) + self.positions, self.dropout)
        for block in self.blocks:
            hidden = block(hidden, self.mask)
        hidden = self.norm(hidden)
        loss = 0
        for stream, (scores, target) in enumerate(zip(self.maps, targets), 1):
            part = hidden[:, stream * self.block : (stream + 1) * self.block]
            loss = loss + functional.cross_entropy(scores(part).flatten(0, 1), target.flatten())
        return loss


def seconds(step, parameters, steps):
    optimiser = torch.optim.Adam(parameters, 3e-4, betas=(0.9, 0.99))

    def once():
        optimiser.zero_grad()
        step().backward()
        torch.nn.utils.clip_grad_norm_(parameters, 1.0)
        optimiser.step()

    once()
    start = time.perf_counter()
    for _ in range(steps):
        once()
    return (time.perf_counter() - start) / steps


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--steps", type=int, default=10)
    options = options.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(1)

    halves = nn.ModuleList([Half(45, 256, 256), Half(27, 256, 256)])
    motion = torch.randn(32, 72, 240)
    parts = lambda: halves[0].loss(motion[:, :45]) + halves[1].loss(motion[:, 45:])
    vqvae = seconds(parts, list(halves.parameters()), options.steps)

    gpt = Gpt(256, 8, 6, 29, 256, 438, 0.1)
    music = torch.randn(32, 29, 438)
    draw = lambda: torch.randint(256, (2, 32, 29))
    codes, targets = draw(), draw()
    gpt = seconds(lambda: gpt.loss(music, codes, targets), list(gpt.parameters()), options.steps)
    print(json.dumps({"torch": torch.__version__, "vqvae": vqvae, "gpt": gpt}))


if __name__ == "__main__":
    main()
