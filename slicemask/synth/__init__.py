"""Cities from a seed, rendered from the street and from above, in VIGOR's, KITTI's and own formats.

Needs the ``synth`` extra: ``pip install 'slicemask[synth]'``.
"""

import lazy_loader

# Imported when first used, so that the registry of switches can be read without the extra.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
