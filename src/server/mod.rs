//! HTTP: routes, limits, errors, OpenAPI.
