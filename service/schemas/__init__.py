"""Requests and answers as the contract has them; the only place that converts degrees."""
