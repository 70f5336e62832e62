"""Values that rl_zoo3's files write as Python, `"dict(net_arch=[64])"`: read, never evaluated."""

from __future__ import annotations

import ast
from typing import Any


def read_mapping(key: str, value: Any) -> dict[str, Any]:
    """A mapping, or the text of one.

    Args:
        key: of the value, for messages.
        value: a mapping, or a text such as `"dict(a=1)"` or `"{'a': 1}"` of literals and classes of
            activations.

    Raises:
        ValueError: if it is neither.

    >>> read_mapping("policy_kwargs", "dict(activation_fn=nn.ReLU, net_arch=dict(pi=[64]))")
    {'activation_fn': 'relu', 'net_arch': {'pi': [64]}}
    """
    found = value
    if isinstance(value, str):
        try:
            found = _literal(ast.parse(value.strip(), mode="eval").body)
        except (ValueError, SyntaxError, TypeError, RecursionError) as error:
            raise ValueError(f"{key} must be a mapping of literals, got {value!r}") from error
    if not isinstance(found, dict) or not all(isinstance(name, str) for name in found):
        raise ValueError(f"{key} must be a mapping, got {value!r}")
    return found


def read_names(key: str, value: Any) -> list[tuple[str, dict[str, Any]]]:
    """Names with arguments: of a name, a mapping of one name to its arguments, or a list of them.

    Raises:
        ValueError: if it is none of these.

    >>> read_names("callback", ["a.B", {"a.C": {"size": 1}}])
    [('a.B', {}), ('a.C', {'size': 1})]
    """
    found = []
    for part in value if isinstance(value, list) else [] if value is None else [value]:
        if isinstance(part, dict) and len(part) == 1:
            name, arguments = next(iter(part.items()))
            found.append((name, read_mapping(key, arguments or {})))
        elif isinstance(part, str):
            found.append((part, {}))
        else:
            raise ValueError(
                f"{key} must be a name, or a mapping of one name to its arguments, got {part!r}"
            )
    return found


def _literal(node: ast.expr) -> Any:
    if isinstance(node, ast.Call):
        if not isinstance(node.func, ast.Name) or node.func.id != "dict" or node.args:
            raise ValueError(f"only dict is called, got {ast.unparse(node)}")
        return {str(each.arg): _literal(each.value) for each in node.keywords if _has_name(each)}
    if isinstance(node, ast.Dict):
        keys = [_literal(each) if each is not None else None for each in node.keys]
        return dict(zip(keys, map(_literal, node.values)))
    if isinstance(node, ast.List):
        return [_literal(each) for each in node.elts]
    if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("nn", "th.nn", "torch.nn"):
        return node.attr.lower()  # as the policies here name activations
    return ast.literal_eval(node)


def _has_name(keyword: ast.keyword) -> bool:
    if keyword.arg is None:
        raise ValueError("there is nothing to unpack")
    return True
