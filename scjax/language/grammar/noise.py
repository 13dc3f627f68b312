"""Mistakes that people make when they type: none of them changes what a text asks for."""

from __future__ import annotations

import re
import unicodedata

import numpy as np

from scjax.language.grammar.phrasebook import Phrasebook

_NEIGHBORS = dict(
    zip(
        "abcdefghijklmnopqrstuvwxyz",
        "s vn xv sf wr dg fh gj uo hk jl ko nk bm ip ol wa et ad ry yi cb qe zc tu xs".split(),
        strict=True,
    )
)
_WORD = re.compile(r"(?<!\w)[a-zA-Z]+(?!\w)")
_MIN_LETTERS = 5  # of a word with a typing error; a shorter one may become another word
_LAST_LATIN = 0x36F  # the last accent of Latin letters
_COMMA = re.compile(r"(?<!\d), (?!\d)")
_CASE_SHARES = {"lower": 0.25, "upper": 0.02, "plain": 0.73}


def make_mistakes(text: str, book: Phrasebook, likelihood: float, rng: np.random.Generator) -> str:
    """The text as typed: each kind of mistake is made with the same likelihood."""
    table = book.style
    if rng.random() < likelihood and table.get("abbreviations"):
        text = abbreviate(text, table["abbreviations"], 0.5, rng)
    if rng.random() < likelihood:
        text = drop_words(text, table.get("articles", []), table.get("kept_after_articles", []), 0.7, rng)
    if rng.random() < likelihood:
        text = change_case(text, rng)
    if rng.random() < likelihood:
        text = drop_punctuation(text)
    if rng.random() < likelihood:
        text = drop_accents(text)
    if rng.random() < likelihood:
        text = add_typing_errors(text, book, int(rng.integers(1, 4)), rng)
    return text


def add_typing_errors(text: str, book: Phrasebook, number: int, rng: np.random.Generator) -> str:
    """Errors in up to ``number`` words of five Latin letters or more; number words stay as they are."""
    protected = _protected(book)
    places = [
        match
        for match in _WORD.finditer(text)
        if len(match.group()) >= _MIN_LETTERS and match.group().lower() not in protected
    ]
    chosen = rng.permutation(len(places))[:number]
    for place in sorted(chosen, reverse=True):
        match = places[place]
        text = text[: match.start()] + _misspelled(match.group(), rng) + text[match.end() :]
    return text


def _protected(book: Phrasebook) -> set[str]:
    """Words that state numbers or could turn into others."""
    numbers = book.words["numbers"]
    tables = [numbers] if isinstance(next(iter(numbers.values())), str) else list(numbers.values())
    words = {word for table in tables for text in table.values() for word in _WORD.findall(text.lower())}
    return words | set(book.style.get("protected", ()))


def _misspelled(word: str, rng: np.random.Generator) -> str:
    place = int(rng.integers(1, len(word) - 1))
    kind = int(rng.integers(4))
    if kind == 0:
        return word[:place] + word[place + 1] + word[place] + word[place + 2 :]
    if kind == 1:
        return word[:place] + word[place + 1 :]
    if kind == 2:
        return word[:place] + word[place] + word[place:]
    near = _NEIGHBORS[word[place].lower()]
    return word[:place] + near[int(rng.integers(len(near)))] + word[place + 1 :]


def drop_words(text: str, words: list[str], kept: list[str], share: float, rng: np.random.Generator) -> str:
    """``text`` without some of ``words``, unless they begin one of the ``kept`` phrases ("a few")."""
    if not words:
        return text
    end = "".join(rf"(?! {re.escape(phrase)}\b)" for phrase in kept)
    pattern = re.compile(rf"\b(?:{'|'.join(words)})\b{end} ")
    return pattern.sub(lambda match: "" if rng.random() < share else match.group(), text)


def drop_punctuation(text: str) -> str:
    """``text`` without commas and without a final full stop; commas between digits stay."""
    return _COMMA.sub(" ", text).rstrip(".")


def drop_accents(text: str) -> str:
    """Latin letters without accents, as typed on another keyboard; other scripts stay as they are."""
    letters = unicodedata.normalize("NFD", text)
    is_latin = not any(ord(letter) > _LAST_LATIN for letter in letters)
    return "".join(letter for letter in letters if not unicodedata.combining(letter)) if is_latin else text


def change_case(text: str, rng: np.random.Generator) -> str:
    """``text`` in lower case, rarely in capitals, mostly as it is."""
    kind = rng.choice(list(_CASE_SHARES), p=list(_CASE_SHARES.values()))
    return text.lower() if kind == "lower" else text.upper() if kind == "upper" else text


def abbreviate(text: str, table: dict[str, list[str]], share: float, rng: np.random.Generator) -> str:
    """``text`` with some of its words in another spelling, as in a chat."""
    for word, others in table.items():
        if rng.random() < share:
            other = others[int(rng.integers(len(others)))]
            text = re.sub(rf"\b{re.escape(word)}\b", other, text)
    return text


def capitalize(text: str) -> str:
    """``text`` with its first letter in upper case."""
    return text[:1].upper() + text[1:]
