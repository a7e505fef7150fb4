"""Estimates from past and future: Rauch-Tung-Striebel, two filters."""
