"""What the reader of USD and its process share, which starts faster without the rest."""

from __future__ import annotations

#: Suffixes of layers.
LAYERS = (".usd", ".usda", ".usdc")

#: Why a usd-core before 26.3 does not do.
WITHOUT_GAUSSIANS = "an OpenUSD without Gaussians: "
