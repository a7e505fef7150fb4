"""The RPC model: rational polynomial camera, its formats and its fit."""
