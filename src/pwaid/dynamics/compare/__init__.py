"""Models a user would otherwise pick: linear output error and Hammerstein–Wiener, fitted by simulation error."""

from pwaid.dynamics.compare.block_model import BlockModel, OrderSearch, fit_block_model, search_orders

__all__ = ["BlockModel", "OrderSearch", "fit_block_model", "search_orders"]
