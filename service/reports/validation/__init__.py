"""Validation of depths in normal impact against published tests."""

from service.reports.validation.sections import COUNT, INTRODUCTION, TITLE, sections

__all__ = ["COUNT", "INTRODUCTION", "TITLE", "sections"]
