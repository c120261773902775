# syntax=docker/dockerfile:1

# The build compiles the numeric kernels for any processor of its architecture. So the first job does not wait for a
# compiler, and the image also runs on other machines than the one that built it.
FROM python:3.12-slim AS base
ENV PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/opt/unbend/kernels \
    NUMBA_CPU_NAME=generic

FROM base AS build
RUN python -m venv /opt/unbend/venv
WORKDIR /src
COPY pyproject.toml README.md LICENSE hatch_build.py ./
COPY openapi ./openapi
COPY service ./service
RUN /opt/unbend/venv/bin/pip install --no-cache-dir . \
 && /opt/unbend/venv/bin/python -m compileall -q /opt/unbend/venv \
 && /opt/unbend/venv/bin/python -c "from unbend.jobs.worker import warm_up; warm_up()"

FROM base
RUN useradd --uid 10001 --create-home --shell /usr/sbin/nologin unbend \
 && install --directory --owner unbend --group unbend /library
COPY --from=build --chown=unbend:unbend /opt/unbend /opt/unbend
ENV PATH=/opt/unbend/venv/bin:$PATH \
    UNBEND_LIBRARY=/library/unbend.db
USER 10001
WORKDIR /library
VOLUME /library
EXPOSE 8000
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8000/v1/livez', timeout=4)"]
ENTRYPOINT ["unbend"]
CMD ["serve", "--host", "0.0.0.0", "--port", "8000"]
