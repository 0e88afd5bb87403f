"""The candidate providers."""

from __future__ import annotations

from schemas.families.candidate_providers import CANDIDATE_PROVIDERS
from tasks.candidates.provider import CandidateProvider, ProviderConfig
from tasks.families import member, members

PROVIDERS = members("tasks.candidates", CANDIDATE_PROVIDERS, CandidateProvider)


def provider_of(config: ProviderConfig) -> CandidateProvider:
    """The provider that a config tells."""
    return member(PROVIDERS, config.kind)
