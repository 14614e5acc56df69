"""Any element on a test bench whose answer is a sum of products of signals; a spring unless constants say another."""

from typing import Literal

from stages.science.plant.product_plant import ProductPlant


class StaticMap(ProductPlant):
    """Everything that simulating such an element takes."""

    kind: Literal["static_map"]


PLANT = StaticMap
