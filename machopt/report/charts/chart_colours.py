"""Colours and JSON type of the charts of an optimize report."""

from __future__ import annotations

from typing import Any

Spec = dict[str, Any]  # JSON for assets/*.js

CHOSEN, JIAO, DEFAULT, FOURTH, LIMIT = "#1552b8", "#d9730d", "#7a8490", "#2c8a57", "#b3261e"
