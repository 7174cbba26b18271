"""slicematch: SliceMatch in torch, on slicemask banks.

`Localizer` answers where ground images were taken, with a run that `train` made; `evaluate` and
`predict` are what the commands of these names call. `PoseDataset` is what they take samples from.
`SliceMatch` and `Candidates` are the network and the poses it scores, for training loops of one's
own.
"""

import lazy_loader

# What is public stands in __init__.pyi. Torch is imported when a name that needs it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
