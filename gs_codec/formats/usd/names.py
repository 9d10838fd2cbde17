"""Names shared by the USD reader and its process, which starts faster without the rest."""

from __future__ import annotations

#: Suffixes of layers.
LAYERS = (".usd", ".usda", ".usdc")

#: Message for a usd-core before 26.3.
WITHOUT_GAUSSIANS = "an OpenUSD without Gaussians"
