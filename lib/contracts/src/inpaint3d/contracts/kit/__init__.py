"""The stage kit: what a stage runs in (`shim`, `context`), what names its result (`keys`, `code`), what it is held to
(`suite`).
"""
