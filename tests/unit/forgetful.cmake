cmake_minimum_required(VERSION 3.25)
# A model that forgets a part does not compile, and the compiler says which part in a sentence.
set(folder ${CMAKE_CURRENT_BINARY_DIR}/forgetful)
file(MAKE_DIRECTORY ${folder})

# of_model(HEADER LIST): what follows is about this model, alone in a list.
macro(of_model header list)
  file(READ ${ROOT}/cellmodels/models/${header} whole)
  set(list "${list}")
endmacro()

# must_say(SENTENCE PATTERN REPLACEMENT): of the model with a part taken out or changed.
function(must_say sentence pattern replacement)
  set(text "${whole}")
  if(NOT pattern STREQUAL "")
    string(REGEX REPLACE "${pattern}" "${replacement}" text "${whole}")
    if(text STREQUAL whole)
      message(FATAL_ERROR "the model has no '${pattern}' to be taken out")
    endif()
  endif()
  file(WRITE ${folder}/model.cpp "#include <wiggers/cellmodels/models/force_model.hpp>\n${text}\n"
       "namespace wiggers { ${list} list; }\n")
  execute_process(COMMAND ${COMPILER} -std=c++20 -fsyntax-only -I${INCLUDE} ${folder}/model.cpp
                  RESULT_VARIABLE status ERROR_VARIABLE said)
  if(sentence STREQUAL "")
    if(NOT status EQUAL 0)
      message(FATAL_ERROR "the whole model does not compile:\n${said}")
    endif()
  elseif(status EQUAL 0 OR NOT said MATCHES "${sentence}")
    message(FATAL_ERROR "without '${pattern}' the compiler does not say '${sentence}':\n${said}")
  endif()
endfunction()

of_model(aliev_panfilov.hpp IonicModelList<AlievPanfilov>)
must_say("" "" "")
must_say("has a name, a title, a source and a time_unit" "std::string_view title" "std::string_view heading")
must_say("has a default_stimulus" "StimulusPulse default_stimulus{-20, 2, 0}" "int default_stimulus = 0")
must_say("is marked as the potential" "facts::membrane_potential\\(-80\\)"
         "Quantity{\"V\", \"mV\", -80, -150, 150, \"membrane potential\"}")
must_say("says in no_invariants why" "no_invariants" "no_invariant_at_all")
must_say("derives Constants<P>" "static Constants<P> constants\\(const P\\* parameter\\)" "static Constants<P> derived(const P* parameter)")
must_say("plain numbers of P alone" "P p\\[parameters.size\\(\\)\\];" "double p[parameters.size()];")
must_say("stand as P branch" "static constexpr std::string_view no_invariants"
         "static constexpr std::array branch_potentials = {-40.0};\n  static constexpr std::string_view no_invariants")
must_say("is in mM: facts::free_calcium" "Quantity{\"v\", \"1\", 0, -5, 100, \"recovery\"}"
         "marked(Role::calcium, Quantity{\"v\", \"uM\", 0, 0, 100, \"calcium\"})")
must_say("evaluates: evaluate<N>" "> evaluate\\(const N\\* y" "> assess(const N* y")
must_say("voltage gates need voltage_gates" "Quantity{\"v\", \"1\", 0, -5, 100, \"recovery\"}" "facts::voltage_gate(\"v\", 0, \"recovery\")")
must_say("named \"default\"|named .\"default" "ParameterSet{\"default\"" "ParameterSet{\"paper\"")
must_say("named_as<Parameter>" "enum Parameter { k, a," "enum Parameter { a, k,")
must_say("well_formed" "\"resting potential\"" "\"\"")

of_model(land2017.hpp ForceModelList<Land2017>)
must_say("" "" "")
must_say("one parameter of a force model is its strength" "Role::strength" "Role::none")
must_say("is facts::reference_length" "facts::reference_length\\(1.9\\)" "facts::positive(\"SL0\", \"um\", 1.9, \"length\")")
must_say("observes facts::active_tension" "facts::active_stiffness" "facts::output(\"Ka\", \"kPa\", \"stiffness\")")
must_say("hold its parameters as P p" "P p\\[parameters.size\\(\\)\\];" "P q[parameters.size()]; P* p;")
must_say("derivative is a" "std::array<N, 1> derivative;" "N derivative[1];")
must_say("steps by regulation, regulate and cycle" "static bool cycle" "static bool turn")
must_say("gives tension and stiffness, holds_at and beyond" "static std::string beyond" "static std::string too_long")
must_say("says in no_invariants why" "no_invariants" "no_invariant_at_all")
