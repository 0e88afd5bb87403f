"""Items on a support: what there is, as a vision-language model sees it or as a list says."""

from __future__ import annotations

from tasks.capture.small_objects.items.asked import AskedItems, ToldItems, asked_items
from tasks.capture.small_objects.items.item import SupportItem, names_of
from tasks.capture.small_objects.items.listed import ListedItems, listed_names
from tasks.settings import union_of

ItemSettings = union_of((ListedItems, AskedItems))
"""Whoever can say what is on a support."""

__all__ = ["AskedItems", "ItemSettings", "ListedItems", "SupportItem", "ToldItems", "asked_items", "listed_names", "names_of"]
