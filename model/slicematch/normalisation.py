"""Mean and deviation that images are normalised with; apart, since settings need no torch."""

Triple = tuple[float, float, float]

# Of ImageNet's images, red, green and blue in [0, 1]: what most backbones were trained with.
IMAGENET_MEAN: Triple = (0.485, 0.456, 0.406)
IMAGENET_STD: Triple = (0.229, 0.224, 0.225)
