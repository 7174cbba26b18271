"""Cities from a seed, rendered from the street and from above, in VIGOR's and KITTI's formats.

Needs the ``synth`` extra: ``pip install 'slicemask[synth]'``.
"""

from slicemask.synth.generate import SynthResult, generate_kitti, generate_vigor

__all__ = ["SynthResult", "generate_kitti", "generate_vigor"]
