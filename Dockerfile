# The service and nothing else: no tests, no development tools, no compiler.
#   docker build --tag ricochet .
#   docker build --build-arg REQUIREMENTS=cluster --tag ricochet:cluster .    # with Dask, see compose.yaml
#   docker build --build-arg REQUIREMENTS=full --tag ricochet:full .    # with every extra: Parquet, /mcp, traces, Dask
#   docker run --rm --volume ricochet:/data ricochet ricochet keys add --owner NAME
#   docker run --init --publish 127.0.0.1:8000:8000 --volume ricochet:/data ricochet
# It listens on all addresses and therefore requires a key; RICOCHET_ACCESS=open serves everybody (docs/access.md).

# The digest names the index for all platforms: Python 3.13.15 on Debian 13. Both FROM lines have the same digest; see CONTRIBUTING.md.
FROM python:3.13-slim@sha256:7c61056e61ac89e852de05f3dc6fa51a6dd2181797bceed46aa725dd7cb2cd3b AS build

ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
ARG REQUIREMENTS=run
WORKDIR /src
RUN python -m venv /opt/ricochet
COPY requirements/build.txt requirements/run.txt requirements/cluster.txt requirements/full.txt requirements/
RUN python -m pip install --require-hashes --only-binary :all: --requirement requirements/build.txt \
    && /opt/ricochet/bin/python -m pip install --require-hashes --only-binary :all: \
        --requirement "requirements/${REQUIREMENTS:-run}.txt"
COPY pyproject.toml README.md LICENSE ricochet_command.py ./
COPY service/ service/
COPY solver/ solver/
RUN python -m pip wheel --no-index --no-deps --no-build-isolation --wheel-dir wheel . \
    && /opt/ricochet/bin/python -m pip install --no-index --no-deps wheel/*.whl

FROM python:3.13-slim@sha256:7c61056e61ac89e852de05f3dc6fa51a6dd2181797bceed46aa725dd7cb2cd3b

ARG VERSION=unknown REVISION=unknown
LABEL org.opencontainers.image.title="ricochet" \
    org.opencontainers.image.description="Critical ricochet angles of rigid projectiles on concrete" \
    org.opencontainers.image.licenses="BSD-3-Clause" \
    org.opencontainers.image.version="${VERSION}" \
    org.opencontainers.image.revision="${REVISION}" \
    org.opencontainers.image.base.name="python:3.13-slim" \
    org.opencontainers.image.base.digest="sha256:7c61056e61ac89e852de05f3dc6fa51a6dd2181797bceed46aa725dd7cb2cd3b"

ENV PATH=/opt/ricochet/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    MALLOC_ARENA_MAX=2 \
    MALLOC_TRIM_THRESHOLD_=131072 \
    NUMBA_CACHE_DIR=/opt/ricochet/compiled \
    XDG_CACHE_HOME=/var/cache/ricochet \
    RICOCHET_HOST=0.0.0.0 \
    RICOCHET_PORT=8000 \
    RICOCHET_DATA_DIR=/data
RUN useradd --system --user-group --uid 10001 --no-create-home --shell /usr/sbin/nologin ricochet \
    && install --directory --owner ricochet --group ricochet /data /var/cache/ricochet
COPY --from=build /opt/ricochet /opt/ricochet
COPY entry-point.sh /opt/ricochet/bin/
# Compile for each processor named in entry-point.sh that the build machine can run. On others the first start compiles, into XDG_CACHE_HOME.
RUN entry-point.sh --each python -c "import solver; solver.warm_up(print)"
USER 10001

VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as u; u.build_opener(u.ProxyHandler({})).open(f'http://127.0.0.1:{os.environ[\"RICOCHET_PORT\"]}/livez', timeout=2)"]
ENTRYPOINT ["entry-point.sh"]
CMD ["ricochet", "serve"]
