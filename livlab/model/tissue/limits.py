"""What a value of a tissue does not do in this model: words for a study or a fit in which it moves nothing."""

from __future__ import annotations

from livlab.model.tissue.readings import Reading
from livlab.model.tissue.tissue import Tissue


def limits_of(tissue: Tissue, path: str, reading: Reading) -> tuple[str, ...]:
    """Sentences on why a value may move less than a reader expects; none for what is no value of an element.

    Parameters
    ----------
    tissue, reading
        The tissue, and how it is read: a reading does without some elements, a profile gives some fractions.
    path
        As `livlab.model.tissue.tissue.override` takes it.

    Examples
    --------
    >>> from livlab.model.tissue.presets import load_preset
    >>> from livlab.model.tissue.readings import READINGS
    >>> liver, lipid = load_preset("liver"), "layers.parenchyma.elements.lipid_and_water.parts.lipid.share"
    >>> limits_of(liver, lipid, READINGS["measured"])
    ('In this model lipid only absorbs and does not scatter: a larger share of it adds no droplets.',)
    >>> limits_of(liver, "layers.parenchyma.elements.hepatocyte.fraction", READINGS["measured"])
    ('The reading measured does without hepatocyte, for which published stands in.',)
    """
    words = path.split(".")
    if len(words) < 5 or words[0] != "layers" or words[2] != "elements":
        return ()
    layers = {name: layer for k, layer in enumerate(tissue.layers) for name in (layer.name, str(k))}
    layer, name, key = layers.get(words[1]), words[3], ".".join(words[4:])
    if layer is None or name not in layer.elements:
        return ()
    read = next(x for x in tissue.under(reading).layers if x.name == layer.name)
    if name not in read.elements:
        instead = (n for n, x in layer.elements.items() if x.stands_in_for == name)
        other = next(instead, layer.elements[name].stands_in_for)
        how = f"for which {other} stands in" if other in read.elements else "which is not there"
        return (f"The reading {reading.name} does without {name}, {how}.",)
    element = read.elements[name]
    if key == element.share_key() and any(name in part.fractions for part in layer.profile):
        return (f"The profile of {layer.name} gives {name} its fraction in each sublayer: this one is not used.",)
    said = element.limits(name, key)
    return (said,) if said else ()


__all__ = ["limits_of"]
