function [force, state] = joint_step(state, y, v, p)
%JOINT_STEP Force of the joint [N] after a monotone move of its displacement, exact.
%   [FORCE, STATE] = JOINT_STEP(STATE, Y, V, P) goes on from STATE, [] at rest, to the displacement
%   Y [m] with the velocity V [m/s]. P are the parameters in the order of joint_parameters.m, which
%   are taken where P is left out. FORCE is that of the joint's laws; beside them stand the spring
%   P(2) [N/m] and the dashpot P(3) [N s/m] of the modal mass P(1) [kg].
%   Laws: {{ laws | join(", ") or "none" }}. Written by jbw {{ version }} for MATLAB and Octave; tested in Octave.
{{ about | commented("%   ") }}
if nargin < 4
    p = joint_parameters();
end
if isempty(state)
    state = zeros(1, {{ 1 + memory }});
end
from = state(1);
force = 0;
{% set ns = namespace(p=4, m=2) %}
{% for form in forms %}
[one, state({{ ns.m }}:{{ ns.m + form.memory - 1 }})] = {{ form.name }}( ...
    p({{ ns.p }}:{{ ns.p + form.num - 1 }}), state({{ ns.m }}:{{ ns.m + form.memory - 1 }}), from, y, v);
force = force + p(1) * one;
{% set ns.p = ns.p + form.num %}
{% set ns.m = ns.m + form.memory %}
{% endfor %}
state(1) = y;
end

{% include "matlab/branches.m" %}

{% for form in forms %}
{% include form.file %}

{% endfor %}
