"""Turn a schema violation into: file, line, key's full path, value, bound, remedy."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from livlab.errors import ConfigError, LivlabError, briefly

if TYPE_CHECKING:
    from pydantic import ValidationError

Path = tuple[str | int, ...]

_MOST = 8
_BARE = r"[A-Za-z0-9_-]+"
_KEY = rf'(?:{_BARE}|"[^"\n]*"|\'[^\'\n]*\')'
_HEADER = re.compile(rf"^\s*(\[\[?)\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]\]?")
_INNER = re.compile(r"^([A-Za-z_]\w*(?:\[\d+\]|\.[A-Za-z_]\w*)*)(?= = )")
_ASSIGN = re.compile(rf"^\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*=")


def explain(
    error: ValidationError, data: dict[str, Any], text: str, schema: dict[str, Any], source: str
) -> ConfigError:
    """One `ConfigError` for a pydantic `ValidationError`: every trouble with its line, path, value, bound, remedy."""
    lines = locate(text)
    found: list[tuple[str, str]] = []
    items = error.errors(include_url=False)
    for item in items:
        inside = [x["loc"] for x in items if len(x["loc"]) > len(item["loc"])]
        if item["type"] == "too_short" and any(loc[: len(item["loc"])] == item["loc"] for loc in inside):
            continue  # what is wrong within is told; that nothing right is left follows from it
        path = _path_in(item["loc"], data, absent=item["type"] == "missing")
        message, remedy = _one(dict(item), path, data, schema)
        cause = (item.get("ctx") or {}).get("error")
        if isinstance(cause, LivlabError):
            path, message = _named(path, cause.message, data)
        line = _line_of(path, lines)
        entry = (f"line {line}: {message}" if line else message, remedy)
        if entry not in found:
            found.append(entry)
    if len(found) == 1:
        message, remedy = found[0]
        joint = ", " if message.startswith("line ") else ": "
        return ConfigError(f"{source}{joint}{message}", remedy=remedy)
    shown = [f"  {message} {remedy}".rstrip() for message, remedy in found[:_MOST]]
    if len(found) > _MOST:
        shown.append(f"  … and {len(found) - _MOST} more.")
    return ConfigError(f"{source}: {len(found)} troubles:\n" + "\n".join(shown), remedy="Mend each of them.")


def dotted(path: Path) -> str:
    """A key's full path as one would write it.

    >>> dotted(("reading", 1, "options", "redirect"))
    'reading[1].options.redirect'
    """
    out = ""
    for part in path:
        out += f"[{part}]" if isinstance(part, int) else (f".{part}" if out else part)
    return out


def nearest(word: str, known: Iterable[str]) -> str:
    """Question "Did you mean …?" for a near miss, else nothing.

    >>> nearest("wavelenghts", ["wavelengths", "tissue"])
    "Did you mean 'wavelengths'?"
    """
    known = list(known)
    folded = {k.lower().replace("-", "_").replace(" ", "_"): k for k in known}
    hits = difflib.get_close_matches(word.lower().replace("-", "_").replace(" ", "_"), folded, n=1, cutoff=0.6)
    return f"Did you mean {folded[hits[0]]!r}?" if hits else ""


def locate(text: str) -> dict[Path, int]:
    r"""Line of every key that a TOML text assigns or opens as a table (keys inside inline values are not listed).

    >>> locate('a = 1\n[b]\nc.d = 2\n[[e]]\n[[e]]\nf = 3')[("e", 1, "f")]
    6
    """
    found: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    depth, quote = 0, ""
    for number, line in enumerate(text.splitlines(), start=1):
        rest = line
        if not depth and not quote:
            if head := _HEADER.match(line):
                parts: Path = ()
                keys = _keys(head[2])
                for position, key in enumerate(keys):
                    parts = (*parts, key)
                    last = position == len(keys) - 1
                    if last and head[1] == "[[":
                        counts[parts] = counts.get(parts, -1) + 1
                    if parts in counts:
                        parts = (*parts, counts[parts])
                table = parts
                found.setdefault(table, number)
                continue
            if assign := _ASSIGN.match(line):
                path = table
                for key in _keys(assign[1]):
                    path = (*path, key)
                    found.setdefault(path, number)
                rest = line[assign.end() :]
        depth, quote = _scan(rest, depth, quote)
    return found


def _scan(line: str, depth: int, quote: str) -> tuple[int, str]:
    """Bracket depth and open multi-line quote after a line."""
    k = 0
    while k < len(line):
        if quote:
            if quote == '"""' and line[k] == "\\":
                k += 2
            elif line.startswith(quote, k):
                k, quote = k + 3, ""
            else:
                k += 1
            continue
        c = line[k]
        if c == "#":
            break
        if line.startswith(('"""', "'''"), k):
            quote, k = line[k : k + 3], k + 3
            continue
        if c in "\"'":
            end = re.compile(r'"(?:\\.|[^"\\])*"' if c == '"' else r"'[^']*'").match(line, k)
            k = end.end() if end else len(line)
            continue
        depth += (c in "[{") - (c in "]}")
        k += 1
    return max(depth, 0), quote


def _keys(dotted_key: str) -> list[str]:
    return [k.strip("\"'") for k in re.findall(_KEY, dotted_key)]


def _line_of(path: Path, lines: dict[Path, int]) -> int:
    while path:
        if path in lines:
            return lines[path]
        path = path[:-1]
    return 0


def _path_in(loc: Path, data: Any, *, absent: bool) -> Path:
    """The path as the file has it (an absent key last): pydantic's own marks, a union's tag for one, left out."""
    path: Path = ()
    here = data
    for position, part in enumerate(loc):
        last = position == len(loc) - 1
        inside = (isinstance(here, dict) and part in here) or (
            isinstance(here, list) and isinstance(part, int) and part < len(here)
        )
        if inside:
            path, here = (*path, part), here[part]
        elif absent and last:
            path = (*path, part)
    return path


def _named(path: Path, message: str, data: Any) -> tuple[Path, str]:
    """Path and message of an error of livlab's own, which may begin with the name of a key below the path."""
    here = data
    for part in path:
        here = here[part]
    inner: Path = ()
    if begins := _INNER.match(message):
        for key, number in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", begins[1]):
            part = key or int(number)
            try:
                here = here[part]
            except (LookupError, TypeError):
                break
            inner = (*inner, part)
        else:
            return (*path, *inner), dotted((*path, *inner)) + message[begins.end(1) :]
        if path and begins[1] == path[-1]:
            return path, dotted(path) + message[begins.end(1) :]
    return (*path, *inner), f"{dotted(path)}: {message}" if path else message


def _one(item: dict[str, Any], path: Path, data: Any, schema: dict[str, Any]) -> tuple[str, str]:
    kind, ctx = str(item["type"]), item.get("ctx") or {}
    name = dotted(path) or "experiment"
    cause = ctx.get("error")
    if isinstance(cause, LivlabError):
        return cause.message, cause.remedy
    if kind == "missing":
        return f"{name}: the key is missing.", "Add it."
    shown = briefly(item.get("input"))
    if kind == "extra_forbidden":
        known = allowed_keys(schema, path[:-1], data)
        hint = nearest(str(path[-1]), known)
        return f"{name} = {shown}: unknown key.", hint or f"Known here: {', '.join(known)}."
    bound = str(item["msg"]).removeprefix("Value error, ")
    bound = re.sub(r"^(Input|String|List|Tuple) should ", "must ", bound)
    if kind in ("literal_error", "enum", "union_tag_invalid"):
        options = re.findall(r"'([^']*)'", str(ctx.get("expected") or ctx.get("expected_tags") or ""))
        value = item.get("input")
        if kind == "union_tag_invalid":
            tag = str(ctx.get("discriminator", "")).strip("'")
            name, shown, value = f"{name}.{tag}", repr(ctx.get("tag")), ctx.get("tag")
        bound = "must be one of " + ", ".join(repr(o) for o in options)
        return f"{name} = {shown}: {bound}.", nearest(str(value), options) or "Pick one."
    if kind == "union_tag_not_found":
        tag = str(ctx.get("discriminator", "")).strip("'")
        return f"{name}.{tag}: the key is missing.", "Add it."
    return f"{name} = {shown}: {bound.rstrip('.')}.", _remedy(kind, ctx)


def _remedy(kind: str, ctx: dict[str, Any]) -> str:
    limit = next((ctx[k] for k in ("gt", "ge", "lt", "le") if k in ctx), None)
    if kind in ("greater_than", "greater_than_equal"):
        return f"Give {'more than' if kind == 'greater_than' else 'at least'} {limit}."
    if kind in ("less_than", "less_than_equal"):
        return f"Give {'less than' if kind == 'less_than' else 'at most'} {limit}."
    if kind == "finite_number":
        return "Give a finite number."
    if kind == "string_pattern_mismatch":
        return "Use letters, digits, '-' and '_' only, with no '/' or leading dot."
    if kind.endswith("_type") or kind.endswith("_parsing"):
        return f"Give {'an' if kind[0] in 'aio' else 'a'} {kind.partition('_')[0]}."
    return "Mend the value; `livlab schema` prints the form."


def allowed_keys(schema: dict[str, Any], path: Path, data: Any) -> list[str]:
    """Keys that the JSON Schema allows in the table at a path of the data, in its order."""
    nodes = [schema]
    here = data
    for part in path:
        here = here[part] if not isinstance(here, dict) or part in here else {}
        nodes = [child for node in _options(nodes, schema) for child in _children(node, part)]
    keys: dict[str, None] = {}
    for node in _options(nodes, schema, here):
        keys.update(dict.fromkeys(node.get("properties", {})))
    return list(keys)


def _children(node: dict[str, Any], part: str | int) -> list[dict[str, Any]]:
    if isinstance(part, int):
        prefix = node.get("prefixItems", [])
        child = prefix[part] if part < len(prefix) else node.get("items")
    else:
        child = node.get("properties", {}).get(part, node.get("additionalProperties"))
    return [child] if isinstance(child, dict) else []


def _options(nodes: list[dict[str, Any]], root: dict[str, Any], here: Any = None) -> list[dict[str, Any]]:
    """Every alternative of the nodes with `$ref`, anyOf, oneOf followed; by its tag where the data carries one."""
    out: list[dict[str, Any]] = []
    for node in nodes:
        ref = node.get("$ref")
        if isinstance(ref, str):
            out += _options([root["$defs"][ref.rsplit("/", 1)[1]]], root, here)
            continue
        tag = node.get("discriminator")
        if isinstance(tag, dict) and isinstance(here, dict):
            target = tag["mapping"].get(here.get(tag["propertyName"]))
            if target:
                out += _options([{"$ref": target}], root, here)
                continue
        branches = [*node.get("anyOf", ()), *node.get("oneOf", ()), *node.get("allOf", ())]
        out += _options(branches, root, here) if branches else [node]
    return out
