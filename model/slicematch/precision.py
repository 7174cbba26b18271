"""The precisions that encoders compute in, by name; no torch, so that commands can list them."""

from typing import Literal

# Lightning's names.
Precision = Literal["32-true", "16-mixed", "bf16-mixed"]
