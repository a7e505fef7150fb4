"""The real chains: public samples from product or image pair to accuracy, DSM and RPC."""
