function p = joint_parameters()
%JOINT_PARAMETERS Parameters of the joint for joint_step.m, in SI units.
{{ about | commented("%   ") }}
p = [ ...
{% for one in parameters %}
    {{ one.value | number }}, ...  % {{ one.name }} [{{ one.unit }}], {{ one.meaning }}
{% endfor %}
    ];
end
